/* Forward and inverse kinematics of batches of poses: the kernel of the exported C, compiled for vectors of poses.
 *
 * Every shape of robot (numbers of drives, rods and hinges, and which hangs on which) is a file of its own that includes
 * this one, so that all loops have known bounds. Loaded by pcalib/mechanics/native.py, which says what is passed.
 */
#include <math.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GNUC__)
#pragma GCC target("avx2,fma")
#define HERE __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")
#else
#define HERE 1
#endif

#define LANES 4
typedef double real __attribute__((vector_size(8 * LANES)));
typedef long long mask __attribute__((vector_size(8 * LANES)));

static inline real chosen(mask where, real a, real b)
{
#ifdef __AVX__
    return __builtin_ia32_blendvpd256(b, a, (real)where);
#else
    return (real)((where & (mask)a) | (~where & (mask)b));
#endif
}
static inline int any(mask where)
{
    long long out = 0;
    int l;
    for (l = 0; l < LANES; l++) out |= where[l];
    return out != 0;
}
static inline real FABS(real a) { return (real)((mask)a & 0x7fffffffffffffffLL); }
static inline real SQRT(real a)
{
    int l;
    for (l = 0; l < LANES; l++) a[l] = sqrt(a[l]);
    return a;
}

/* To 2e-8 (Abramowitz and Stegun 4.4.49), enough for what it is used for: where Newton starts. */
static inline real ATAN2(real y, real x)
{
    const real high = FABS(y), wide = FABS(x);
    const real t = chosen(high > wide, wide, high) / chosen(high > wide, high, wide), z = t * t;
    real a = t * (1.0 + z * (-0.3333314528 + z * (0.1999355085 + z * (-0.1420889944 + z * (0.1065626393
        + z * (-0.0752896400 + z * (0.0429096138 + z * (-0.0161657367 + z * 0.0028662257))))))));
    a = chosen(high > wide, 1.57079632679489661923 - a, a);
    a = chosen(x < 0.0, 3.14159265358979323846 - a, a);
    return chosen(y < 0.0, -a, a);
}

/* Sine of a + quarter * pi / 2: remainder by pi / 2 in three parts (Cody and Waite), polynomials of fdlibm's k_sin and
 * k_cos (Sun Microsystems 1993). Exact to rounding up to 1e5 rad, which no joint reaches. */
static inline real sine(real a, double quarter)
{
    const double big = 6755399441055744.0; /* 1.5 * 2^52: adding it rounds to a whole number in the lowest bits */
    const real turned = a * 0.63661977236758134308 + big, n = turned - big;
    const mask whole = (mask)turned + (long long)quarter;
    const real x = ((a - n * 1.57079632673412561417e+00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
    const real z = x * x;
    const real s = x + x * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03
        + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06
        + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    const real c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
        + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07
        + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    const real out = chosen((whole & 1) != 0, c, s);
    return (real)((mask)out ^ ((whole & 2) << 62));
}
#define SIN(a) sine(a, 0.0)
#define COS(a) sine(a, 1.0)
#define ANY(condition) any(condition)
#define SELECT(condition, a, b) chosen(condition, a, b)
#define UNROLL _Pragma("GCC unroll 8")

#define ROUNDS 10    /* easy poses need three to five; what is left is solved by NumPy */
#define NEARLY 1e-9  /* as in the exported code */
#define CLOSE 2e-15  /* as in the exported code */
#define CLOSED 1e-14 /* TOLERANCE of kinematics.py */
#define FINE 1e-12   /* where a compensation to first order begins: times an error, that is rounding */
#define SINGULAR 1e12 /* as in kinematics.py */
#define MOST_PARAMETERS 128 /* as in native.py */

/* Effects come as deviations, each null or an array with a row per pose: drives (NQ), rods (M), base-side anchors (M, 3)
 * and plate-side anchors (M, 3), as Deviation of loops.py. */
typedef struct {
    const double *drive, *rod, *elbow, *plate;
} deviation;

static deviation DEVIATION; /* of the call that runs, and where it is: the interpreter's lock is held */
static long POSES, POSE;

static real entry(const double *from, int width, int c)
{
    real all = {0.0};
    int l;
    for (l = 0; l < LANES; l++) all[l] = from[width * (POSE + l < POSES ? POSE + l : POSES - 1) + c];
    return all;
}
#define DEVIATE_DRIVE(i, q) \
    if (DEVIATION.drive) q += entry(DEVIATION.drive, NQ, i);
#define DEVIATE_ROD(r, at) \
    if (DEVIATION.rod) at->l[r] += entry(DEVIATION.rod, M, r); \
    if (DEVIATION.elbow) deviate(at->A[r], DEVIATION.elbow, r);
#define DEVIATE_PLATE(r, b) \
    if (DEVIATION.plate) deviate(b, DEVIATION.plate, r);

static void deviate(real point[3], const double *by, int r)
{
    int i;
    for (i = 0; i < 3; i++) point[i] += entry(by, 3 * M, 3 * r + i);
}

/* and not by effects of the numbers themselves */
#define WAVES 0
#define RODS_GROW 0
#define ARMS_GROW 0
#define BASE_GROWS 0
static const double NONE[16], *const NO_WAVES[1];
#define RATIO NONE
#define CYCLES NONE
#define WAVE_SINE NO_WAVES
#define WAVE_COSINE NO_WAVES
#define ROD_GROWTH NONE
#define ARM_GROWTH NONE
#define BASE_GROWTH NONE
#define PIVOT T->centre

/* The numbers of a robot: see table() of native.py, which writes them in this order. */
#define CENTRE T->centre
#define COSINE T->cosine
#define SINE T->sine
#define SLOPE T->slope
#define LENGTH T->length
#define RATE T->rate
#define PLATE T->plate
#define GUIDE_COSINE T->guide_cosine
#define GUIDE_SINE T->guide_sine
#define GUIDE_LENGTH T->guide_length
#define HINGE_POINT T->hinge_point
#define HINGE_AXIS T->hinge_axis
#define TURNS (T->turns != 0.0)
#define ROD_SIDE T->rod_side
#define MAX_TILT T->max_tilt

static const int ACTUATOR[] = {ACTUATORS}, GUIDED[] = {GUIDES}, DOF[] = {DOFS}, FREE[] = {FREES};
#if H > 0
static const int BODY[] = {BODIES};
#endif

typedef struct {
    double centre[M][3], cosine[M][3], sine[M][3], slope[M][3], length[M], rate[M], plate[M][3];
    double guide_cosine[M][3], guide_sine[M][3], guide_length[M];
    double turns, rod_side, max_tilt;
#if H > 0
    double hinge_point[H][3], hinge_axis[H][3];
#endif
} table;

static const table *T; /* of the call that runs: the interpreter's lock is held */

/* Inlined throughout, so that the compiler sees constant bounds: a quarter less time. */
#if defined(__GNUC__)
#define static static inline __attribute__((always_inline))
#endif
#include "kernel.c"
#undef static

/* Rows POSE to POSE + LANES of an array, the last one again beyond its end; and back. */
static void load(const double *from, int width, real *to)
{
    int c;
    for (c = 0; c < width; c++) to[c] = entry(from, width, c);
}

static void store(const real *from, int width, double *to)
{
    int l, c;
    for (l = 0; l < LANES && POSE + l < POSES; l++)
        for (c = 0; c < width; c++) to[width * (POSE + l) + c] = from[c][l];
}

static void unturned(real R[9])
{
    const real zero = {0.0};
    int c;
    for (c = 0; c < 9; c++) R[c] = c % 4 ? zero : 1.0 + zero;
}

/* A start for Newton with the plate unturned: rods 2j and 2j + 1 are one virtual rod, and the lower of the two points
 * in which three spheres meet is the plate; as trilaterate() of kinds/delta.py. NaN where they do not meet. */
static void meet(const closure *at, real x[3])
{
#if M == 6
    real c[3][3], square[3], e[3], f[3], ee, ff, ef, ge, gf, det, u, v, foot[3], normal[3], size, height;
    int i, j;
    for (j = 0; j < 3; j++) {
        const real l = 0.5 * (at->l[2 * j] + at->l[2 * j + 1]);
        square[j] = l * l;
        for (i = 0; i < 3; i++)
            c[j][i] = 0.5 * (at->A[2 * j][i] + at->A[2 * j + 1][i] - at->b[2 * j][i] - at->b[2 * j + 1][i]);
    }
    for (i = 0; i < 3; i++) e[i] = c[1][i] - c[0][i], f[i] = c[2][i] - c[0][i];
    ee = DOT(e, e), ff = DOT(f, f), ef = DOT(e, f);
    ge = 0.5 * (ee + square[0] - square[1]), gf = 0.5 * (ff + square[0] - square[2]);
    det = 1.0 / (ee * ff - ef * ef);
    u = (ge * ff - gf * ef) * det, v = (gf * ee - ge * ef) * det;
    for (i = 0; i < 3; i++) foot[i] = u * e[i] + v * f[i];
    cross3(e, f, normal);
    size = SQRT((square[0] - DOT(foot, foot)) * det);
    height = SELECT(normal[2] > 0.0, -size, size);
    for (i = 0; i < 3; i++) x[i] = c[0][i] + foot[i] + height * normal[i];
#else
    (void)at;
    (void)x;
#endif
}

/* Of the commands of a pose. */
typedef struct {
    real cosine[NQ], sine[NQ];
} turned;

static void turn_drives(const real q[NQ], turned *drive)
{
    int i;
    for (i = 0; i < NQ; i++) drive->cosine[i] = COS(q[i]), drive->sine[i] = SIN(q[i]);
}

/* Change of f by a base-side parameter: 14 numbers, `stride` apart, times n, n cos q, n sin q, n q, 1 and q. */
static real by_base(const double *slope, int stride, const closure *at, const real q[NQ], const turned *drive, int r)
{
    const int a = ACTUATOR[r];
    real sum[4];
    int i, c;
    for (i = 0; i < 4; i++) {
        sum[i] = slope[3 * i * stride] * at->n[r][0];
        for (c = 1; c < 3; c++) sum[i] += slope[(3 * i + c) * stride] * at->n[r][c];
    }
    return sum[0] + drive->cosine[a] * sum[1] + drive->sine[a] * sum[2] + q[a] * (sum[3] + slope[13 * stride])
        + slope[12 * stride];
}

/* Change of f by component c of the joint on the plate. */
static real by_plate(const closure *at, const real R[9], int r, int c)
{
    return R[c] * at->n[r][0] + R[3 + c] * at->n[r][1] + R[6 + c] * at->n[r][2];
}

/* Commands one step further, to first order with geometric errors: of each rod 14 numbers as of by_base(), 3 of its
 * joint on the plate. A step that is not finite makes `worst` so. */
static void compensated(const double *errors, const closure *at, const real R[9], real q[NQ], real *worst)
{
    real J[M][M], step[M];
    turned drive;
    int r, i;
    turn_drives(q, &drive);
    by_unknowns(1, at, R, J);
    for (r = 0; r < M; r++) {
        const double *error = errors + 17 * r;
        step[r] = -at->f[r] - by_base(error, 1, at, q, &drive, r);
        for (i = 0; i < 3; i++) step[r] -= error[14 + i] * by_plate(at, R, r, i);
    }
    solve(J, step);
    for (i = 0; i < NQ; i++) q[i] += step[i], *worst += 0.0 * step[i];
}

/* What is left of the loops' errors, and whether a pose is solved: closed to rounding on the working branch. */
static void judge(
    const closure *at, const real R[9], const real R0[9], real worst, double most, double *residual, char *solved)
{
    const real room = margin(at, R, R0);
    int l;
    store(&worst, 1, residual);
    for (l = 0; l < LANES && POSE + l < POSES; l++) solved[POSE + l] = worst[l] <= most && room[l] > 0.0;
}

#define JOINED(a, b) a##b
#define NAMED(shape, what) JOINED(shape, what)

/* What fits this shape, beside the numbers: native.py compares it with a mechanism. */
const int NAMED(SHAPE, _topology)[] = {NQ, M, H, ND, TILT_FREE, KEEP_YAW, ACTUATORS, BODIES, GUIDES, DOFS, FREES};

int NAMED(SHAPE, _runs_here)(void) { return HERE; }

/* x, R and phi are where to start if `started`, and the solution. */
void NAMED(SHAPE, _forward)(
    const double *numbers, long n, int started, const deviation *deviates, const double *commands, double *x, double *R,
    double *phi, double *residual, char *solved)
{
    const real origin[3] = {{0.0}};
    const warming none = {0.0, 0.0, 0.0};
    T = (const table *)numbers;
    DEVIATION = *deviates;
    POSES = n;
    for (POSE = 0; POSE < n; POSE += LANES) {
        real q[NQ], p[3] = {{0.0}}, turn[9], turn0[9], hinge[H + 1], worst;
        closure at;
        load(commands, NQ, q);
        base_side(q, &none, &at);
        if (started) {
            load(x, 3, p);
            load(R, 9, turn);
            load(phi, H, hinge);
            plate_side(hinge, at.b);
        } else {
            unturned(turn);
            plate_side(hinge, at.b);
            meet(&at, p);
        }
        memcpy(turn0, turn, sizeof turn);
        worst = newton(0, CLOSE, q, &none, p, turn, hinge, origin, turn0, &at);
        store(p, 3, x);
        store(turn, 9, R);
        store(hinge, H, phi);
        judge(&at, turn, turn0, worst, CLOSED, residual, solved);
    }
}

/* positions of the tool point (n, 3), R0 (n, 9) or null, tools (n, 3). q, R and phi are where to start if `started`, and
 * the solution, with x. With `errors` (M, 17) or null, commands are compensated for them to first order. */
void NAMED(SHAPE, _inverse)(
    const double *numbers, long n, int started, const deviation *deviates, const double *positions, const double *R0,
    const double *tools, const double *errors, double *commands, double *x, double *R, double *phi, double *residual,
    char *solved)
{
    const warming none = {0.0, 0.0, 0.0};
    T = (const table *)numbers;
    DEVIATION = *deviates;
    POSES = n;
    for (POSE = 0; POSE < n; POSE += LANES) {
        real q[NQ], p[3], tool[3], arm[3], place[3], turn[9], turn0[9], hinge[H + 1], worst;
        closure at;
        int c;
        load(positions, 3, p);
        load(tools, 3, tool);
        if (R0) load(R0, 9, turn0);
        else unturned(turn0);
        if (started) {
            load(commands, NQ, q);
            load(R, 9, turn);
            load(phi, H, hinge);
            plate_side(hinge, at.b);
        } else { /* without deviations, which native.py leaves to NumPy here */
            memcpy(turn, turn0, sizeof turn);
            level(turn, hinge);
            plate_side(hinge, at.b);
            turn3(turn, tool, arm);
            for (c = 0; c < 3; c++) place[c] = p[c] - arm[c];
            first_commands(place, turn, &at, q);
        }
        base_side(q, &none, &at);
        worst = newton(1, errors ? FINE : CLOSE, q, &none, p, turn, hinge, tool, turn0, &at);
        if (errors) compensated(errors, &at, turn, q, &worst);
        turn3(turn, tool, arm);
        for (c = 0; c < 3; c++) p[c] -= arm[c];
        store(q, NQ, commands);
        store(p, 3, x);
        store(turn, 9, R);
        store(hinge, H, phi);
        judge(&at, turn, turn0, worst, errors ? FINE : CLOSED, residual, solved);
    }
}

#if M == ND && H == 0
/* Motions (n, M, nk) of the plates about their tool points by every parameter: -J_X^-1 df/dk, as geometry_motion() of
 * prediction.py. `slopes` (M, 14, width) are for by_base(), for each rod's `columns` (M, width + 3), of which the last
 * three are its joint on the plate. */
void NAMED(SHAPE, _motion)(
    const double *numbers, long n, const double *commands, const double *x, const double *R, const double *tools,
    const double *slopes, const int *columns, int width, int nk, double *out)
{
    const deviation rigid = {0};
    const warming none = {0.0, 0.0, 0.0};
    const real zero = {0.0};
    T = (const table *)numbers;
    DEVIATION = rigid;
    POSES = n;
    for (POSE = 0; POSE < n; POSE += LANES) {
        real q[NQ], p[3], turn[9], tool[3], arm[3], J[M][M], inverse[M][M], motion[M][MOST_PARAMETERS], most = zero;
        closure at;
        turned drive;
        int r, i, j, c, l;
        load(commands, NQ, q);
        load(x, 3, p);
        load(R, 9, turn);
        load(tools, 3, tool);
        turn3(turn, tool, arm);
        for (i = 0; i < 3; i++) p[i] += arm[i];
        base_side(q, &none, &at);
        plate_side(NULL, at.b);
        close_loops(p, turn, tool, &at);
        by_unknowns(0, &at, turn, J);
        for (r = 0; r < M; r++) {
            real A[M][M], column[M];
            memcpy(A, J, sizeof A);
            for (i = 0; i < M; i++) column[i] = (i == r ? -1.0 : 0.0) + zero;
            solve(A, column);
            for (i = 0; i < M; i++) {
                inverse[i][r] = column[i];
                most = SELECT(FABS(column[i]) <= most, most, FABS(column[i]) + 0.0 * most); /* NaN stays */
            }
        }
        for (i = 0; i < M; i++)
            for (c = 0; c < nk; c++) motion[i][c] = zero;
        turn_drives(q, &drive);
        for (r = 0; r < M; r++)
            for (j = 0; j < width + 3; j++) {
                const int to = columns[(width + 3) * r + j];
                const real row = j < width ? by_base(slopes + 14 * width * r + j, width, &at, q, &drive, r)
                                           : by_plate(&at, turn, r, j - width);
                for (i = 0; i < M; i++) motion[i][to] += inverse[i][r] * row;
            }
        for (l = 0; l < LANES && POSE + l < n; l++)
            for (i = 0; i < M; i++)
                for (c = 0; c < nk; c++)
                    out[((POSE + l) * M + i) * nk + c] = most[l] <= SINGULAR ? motion[i][c][l] : NAN;
    }
}
#endif
