/* Four drives with two rods each, on bodies that are hinged to the plate: H4. */
#define SHAPE two_bodies
#define NQ 4
#define M 8
#define H 2
#define ND 6
#define TILT_FREE 1
#define KEEP_YAW 1
#define ACTUATORS 0, 0, 1, 1, 2, 2, 3, 3
#define BODIES 1, 1, 1, 1, 2, 2, 2, 2
#define GUIDES 0, 0, 0, 0, 0, 0, 0, 0
#define DOFS 0, 1, 2, 3, 4, 5
#define FREES 3, 4, 6, 7
#include "batch.c"
