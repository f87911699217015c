/* A driven rod and a plate in one plane. */
#define SHAPE plane
#define NQ 1
#define M 3
#define H 0
#define ND 3
#define TILT_FREE 2
#define KEEP_YAW 0
#define ACTUATORS 0, 0, 0
#define BODIES 0, 0, 0
#define GUIDES 0, 0, 1
#define DOFS 0, 1, 5
#define FREES 1, 2
#include "batch.c"
