/* Six drives with a rod each: Hexa, 321-Hexa, hexapod. */
#define SHAPE six_arms
#define NQ 6
#define M 6
#define H 0
#define ND 6
#define TILT_FREE 0
#define KEEP_YAW 0
#define ACTUATORS 0, 1, 2, 3, 4, 5
#define BODIES 0, 0, 0, 0, 0, 0
#define GUIDES 0, 0, 0, 0, 0, 0
#define DOFS 0, 1, 2, 3, 4, 5
#define FREES 0
#include "batch.c"
