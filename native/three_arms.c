/* Three drives with two rods each: Delta, linear Delta. */
#define SHAPE three_arms
#define NQ 3
#define M 6
#define H 0
#define ND 6
#define TILT_FREE 2
#define KEEP_YAW 0
#define ACTUATORS 0, 0, 1, 1, 2, 2
#define BODIES 0, 0, 0, 0, 0, 0
#define GUIDES 0, 0, 0, 0, 0, 0
#define DOFS 0, 1, 2, 3, 4, 5
#define FREES 3, 4, 5
#include "batch.c"
