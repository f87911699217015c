/* ---- rods between anchors: Newton on the closed loops ------------------------------------------------------------
 *
 * Rod r joins a base-side anchor A, moved by one actuator, to a plate-side anchor B:
 *
 *     A = O + C cos q + S sin q + D q        B = x + R b        f = |B - A| - l = 0
 *
 * A guided row has a direction n that its actuator prescribes, and f = n . (B - A). The plate may carry further bodies
 * on hinges. All loops are bounded, nothing is allocated, and nothing is kept between calls.
 *
 * A real is a double. Code that solves several poses at a time defines these words for vectors of them.
 */

#ifndef SELECT
typedef double real;
#define ANY(condition) (condition)
#define SELECT(condition, a, b) ((condition) ? (a) : (b))
#define SQRT sqrt
#define FABS fabs
#define SIN sin
#define COS cos
#define ATAN2 atan2
#define UNROLL
#define DEVIATE_DRIVE(i, q) /* batches have small deviations of every pose from the numbers of the robot */
#define DEVIATE_ROD(r, at)
#define DEVIATE_PLATE(r, b)
#endif
#define DOT(a, b) ((a)[0] * (b)[0] + (a)[1] * (b)[1] + (a)[2] * (b)[2])

typedef struct {
    real A[M][3];  /* base-side anchors */
    real l[M];     /* lengths */
    real b[M][3];  /* plate-side anchors, plate frame, hinges turned */
    real d[M][3];  /* B - A */
    real n[M][3];  /* unit direction, or guide */
    real r[M][3];  /* B minus the reference point, base frame */
    real dA[M][3]; /* derivative of A by q */
    real dn[M][3]; /* derivative of a guide by q */
    real dl[M];    /* derivative of the length by q */
    real f[M];     /* loop error */
} closure;

static void cross3(const real a[3], const real b[3], real out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void turn3(const real R[9], const real v[3], real out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}

static void matmul3(const real A[9], const real B[9], real out[9])
{
    int i, j;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) out[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}

/* Rotation matrix of a rotation vector (Rodrigues). */
static void exp3(const real w[3], real R[9])
{
    const real a2 = DOT(w, w), a = SQRT(a2);
    const real s = SELECT(a < 1e-4, 1.0 - a2 / 6.0, SIN(a) / a);
    const real c = SELECT(a < 1e-4, 0.5 - a2 / 24.0, (1.0 - COS(a)) / a2);
    R[0] = 1.0 - c * (w[1] * w[1] + w[2] * w[2]);
    R[1] = c * w[0] * w[1] - s * w[2];
    R[2] = c * w[0] * w[2] + s * w[1];
    R[3] = c * w[0] * w[1] + s * w[2];
    R[4] = 1.0 - c * (w[0] * w[0] + w[2] * w[2]);
    R[5] = c * w[1] * w[2] - s * w[0];
    R[6] = c * w[0] * w[2] - s * w[1];
    R[7] = c * w[1] * w[2] + s * w[0];
    R[8] = 1.0 - c * (w[0] * w[0] + w[1] * w[1]);
}

/* R with rows that are orthonormal again after many small turns. */
static void orthonormal(real R[9])
{
    real s = 1.0 / SQRT(DOT(R, R));
    int i;
    for (i = 0; i < 3; i++) R[i] *= s;
    s = DOT(R, R + 3);
    for (i = 0; i < 3; i++) R[3 + i] -= s * R[i];
    s = 1.0 / SQRT(DOT(R + 3, R + 3));
    for (i = 0; i < 3; i++) R[3 + i] *= s;
    cross3(R, R + 3, R + 6);
}

/* What temperatures do: lengths in proportion to what is given above 20 degrees. */
typedef struct {
    double rods, arms, base;
} warming;

/* Base-side anchors and lengths, with their derivatives by q, of every rod. */
static void base_side(const real q[NQ], const warming *warm, closure *at)
{
    const real zero = {0.0};
    real c[NQ], s[NQ], true_q[NQ], rate[NQ], c0[NQ], s0[NQ];
    int i, r, w;
    for (i = 0; i < NQ; i++) {
        true_q[i] = q[i] * (1.0 + RATIO[i]);
        rate[i] = 1.0 + RATIO[i] + zero;
        DEVIATE_DRIVE(i, true_q[i])
        for (w = 0; w < WAVES; w++) {
            const double n = CYCLES[w];
            true_q[i] += WAVE_SINE[w][i] * SIN(n * q[i]) + WAVE_COSINE[w][i] * COS(n * q[i]);
            rate[i] += n * (WAVE_SINE[w][i] * COS(n * q[i]) - WAVE_COSINE[w][i] * SIN(n * q[i]));
        }
        c[i] = TURNS ? COS(true_q[i]) : 1.0 + zero;
        s[i] = TURNS ? SIN(true_q[i]) : zero;
        c0[i] = TURNS && ARMS_GROW ? COS(q[i]) : 1.0 + zero;
        s0[i] = TURNS && ARMS_GROW ? SIN(q[i]) : zero;
    }
    for (r = 0; r < M; r++) {
        const int a = ACTUATOR[r];
        const double arm = ARMS_GROW ? ARM_GROWTH[r] * warm->arms : 0.0;
        for (i = 0; i < 3; i++) {
            at->A[r][i] = CENTRE[r][i] + COSINE[r][i] * c[a] + SINE[r][i] * s[a] + SLOPE[r][i] * true_q[a];
            at->dA[r][i] = rate[a] * (SINE[r][i] * c[a] - COSINE[r][i] * s[a] + SLOPE[r][i]);
            if (ARMS_GROW) { /* the arm grows from its base point, at the commanded angle */
                const real out = CENTRE[r][i] + COSINE[r][i] * c0[a] + SINE[r][i] * s0[a] + SLOPE[r][i] * q[a];
                at->A[r][i] += arm * (out - PIVOT[r][i]);
                at->dA[r][i] += arm * (SINE[r][i] * c0[a] - COSINE[r][i] * s0[a] + SLOPE[r][i]);
            }
            if (BASE_GROWS) at->A[r][i] += BASE_GROWTH[r] * warm->base * PIVOT[r][i];
            at->n[r][i] = GUIDED[r] ? GUIDE_COSINE[r][i] * c[a] + GUIDE_SINE[r][i] * s[a] : zero;
            at->dn[r][i] = GUIDED[r] ? rate[a] * (GUIDE_SINE[r][i] * c[a] - GUIDE_COSINE[r][i] * s[a]) : zero;
        }
        at->l[r] = LENGTH[r] + RATE[r] * true_q[a];
        at->dl[r] = RATE[r] * rate[a];
        if (RODS_GROW) {
            at->l[r] += ROD_GROWTH[r] * warm->rods * (LENGTH[r] + RATE[r] * q[a]);
            at->dl[r] += ROD_GROWTH[r] * warm->rods * RATE[r];
        }
        DEVIATE_ROD(r, at)
    }
}

/* Plate-side anchors in the plate frame, hinges turned by phi. */
static void plate_side(const real *phi, real b[M][3])
{
    const real zero = {0.0};
    int r, i;
    for (r = 0; r < M; r++) {
        for (i = 0; i < 3; i++) b[r][i] = PLATE[r][i] + zero;
        DEVIATE_PLATE(r, b[r])
#if H > 0
        if (BODY[r]) {
            const int h = BODY[r] - 1;
            real w[3], R[9], arm[3], out[3];
            for (i = 0; i < 3; i++) w[i] = phi[h] * HINGE_AXIS[h][i];
            for (i = 0; i < 3; i++) arm[i] = b[r][i] - HINGE_POINT[h][i];
            exp3(w, R);
            turn3(R, arm, out);
            for (i = 0; i < 3; i++) b[r][i] = HINGE_POINT[h][i] + out[i];
        }
#endif
    }
#if H == 0
    (void)phi;
#endif
}

/* Hinge angles that keep bodies nearest to their turn at R = I, as parallel rods hold them. */
static void level(const real R[9], real *phi)
{
#if H > 0
    const real v[3] = {R[7] - R[5], R[2] - R[6], R[3] - R[1]};
    int i;
    for (i = 0; i < H; i++) phi[i] = -2.0 * ATAN2(DOT(v, HINGE_AXIS[i]), 1.0 + R[0] + R[4] + R[8]);
#else
    (void)R;
    (void)phi;
#endif
}

/* The closure with the reference point (plate frame) at p; the largest loop error. */
static real close_loops(const real p[3], const real R[9], const real reference[3], closure *at)
{
    real arm[3], worst = {0.0};
    int r, i;
    for (r = 0; r < M; r++) {
        for (i = 0; i < 3; i++) arm[i] = at->b[r][i] - reference[i];
        turn3(R, arm, at->r[r]);
        for (i = 0; i < 3; i++) at->d[r][i] = p[i] + at->r[r][i] - at->A[r][i];
        if (GUIDED[r]) {
            at->f[r] = DOT(at->n[r], at->d[r]) - at->l[r];
        } else {
            const real size = SQRT(DOT(at->d[r], at->d[r])), inverse = 1.0 / size;
            for (i = 0; i < 3; i++) at->n[r][i] = at->d[r][i] * inverse;
            at->f[r] = size - at->l[r];
        }
        worst = SELECT(FABS(at->f[r]) <= worst, worst, FABS(at->f[r]) + 0.0 * worst); /* NaN stays */
    }
    return worst;
}

/* Derivative of f_r by component c of the plate's state: twist at the reference point, then hinge angles. */
static real by_state(const closure *at, const real R[9], int r, int c)
{
    const real zero = {0.0};
    real v[3];
    if (c < ND) {
        const int d = DOF[c];
        if (d < 3) return at->n[r][d];
        cross3(at->r[r], at->n[r], v);
        return v[d - 3];
    }
#if H > 0
    if (BODY[r] == c - ND + 1) {
        const double *axis = HINGE_AXIS[c - ND], *point = HINGE_POINT[c - ND];
        real arm[3], swing[3];
        int i;
        for (i = 0; i < 3; i++) arm[i] = at->b[r][i] - point[i];
        v[0] = axis[1] * arm[2] - axis[2] * arm[1];
        v[1] = axis[2] * arm[0] - axis[0] * arm[2];
        v[2] = axis[0] * arm[1] - axis[1] * arm[0];
        turn3(R, v, swing);
        return DOT(at->n[r], swing);
    }
#else
    (void)R;
#endif
    return zero;
}

static real by_actuator(const closure *at, int r)
{
    const real rate = -DOT(at->n[r], at->dA[r]) - at->dl[r];
    return GUIDED[r] ? rate + DOT(at->dn[r], at->d[r]) : rate;
}

/* y becomes x with A x = y, by elimination; each larger row below is brought up. Not finite where A is singular. */
static void solve(real A[M][M], real y[M])
{
    int i, j, k;
    UNROLL for (k = 0; k < M; k++) {
        real inverse;
        UNROLL for (i = k + 1; i < M; i++) {
            const real up = FABS(A[k][k]), low = FABS(A[i][k]), u = y[k], v = y[i];
            UNROLL for (j = k; j < M; j++) {
                const real a = A[k][j], c = A[i][j];
                A[k][j] = SELECT(low > up, c, a);
                A[i][j] = SELECT(low > up, a, c);
            }
            y[k] = SELECT(low > up, v, u);
            y[i] = SELECT(low > up, u, v);
        }
        inverse = 1.0 / A[k][k];
        UNROLL for (i = k + 1; i < M; i++) {
            const real factor = A[i][k] * inverse;
            UNROLL for (j = k + 1; j < M; j++) A[i][j] -= factor * A[k][j];
            y[i] -= factor * y[k];
        }
        A[k][k] = inverse;
    }
    UNROLL for (k = M - 1; k >= 0; k--) {
        UNROLL for (j = k + 1; j < M; j++) y[k] -= A[k][j] * y[j];
        y[k] *= A[k][k];
    }
}

/* Steps of at most half a metre or radian, so that a far start does not jump to another branch. */
static void limit(real step[M])
{
    real most = {0.0};
    int i;
    for (i = 0; i < M; i++) most = SELECT(FABS(step[i]) > most, FABS(step[i]), most);
    if (ANY(most > 0.5))
        for (i = 0; i < M; i++) step[i] *= SELECT(most > 0.5, 0.5 / most, 1.0 + 0.0 * most);
}

/* R turned about the base's z axis until its twist about it is that of R0 (half angles by their tangents). */
static void keep_yaw(real R[9], const real R0[9])
{
    const real a = 1.0 + R0[0] + R0[4] + R0[8], b = R0[3] - R0[1], c = 1.0 + R[0] + R[4] + R[8], d = R[3] - R[1];
    const real x = a * c + b * d, y = b * c - a * d, size = 1.0 / (x * x + y * y);
    const real co = (x * x - y * y) * size, si = 2.0 * x * y * size;
    int i;
    for (i = 0; i < 9; i += 3) {
        const real first = R[i], second = R[i + 1];
        R[i] = first * co + second * si;
        R[i + 1] = second * co - first * si;
    }
}

/* Derivatives of f by the unknowns: all of the plate's state, or commands and the state that they leave free. */
static void by_unknowns(int inverse, const closure *at, const real R[9], real J[M][M])
{
    const real zero = {0.0};
    const int fixed = inverse ? NQ : 0; /* columns of commands */
    int r, c;
    for (r = 0; r < M; r++) {
        for (c = 0; c < fixed; c++) J[r][c] = ACTUATOR[r] == c ? by_actuator(at, r) : zero;
        for (c = 0; c < M - fixed; c++) J[r][fixed + c] = by_state(at, R, r, inverse ? FREE[c] : c);
    }
}

/* Newton from q, p, R and phi, which become the solution; the largest loop error that is left, at most `close`. The
 * unknowns are those of by_unknowns(), while the reference point stays. Both sides are at these commands and hinges. */
static real newton(
    int inverse, double close, real q[NQ], const warming *warm, real p[3], real R[9], real *phi, const real reference[3],
    const real R0[9], closure *at)
{
    const real zero = {0.0};
    const int fixed = inverse ? NQ : 0;
    real worst = close_loops(p, R, reference, at);
    int round, last = 0, i, r, c; /* where nothing is finite, no comparison holds, and the loop ends */
    for (round = 0; round < ROUNDS && !last && ANY(worst > close); round++) {
        real J[M][M], step[M], w[3], turn[9], turned[9];
        by_unknowns(inverse, at, R, J);
        for (r = 0; r < M; r++) step[r] = -at->f[r];
        last = !ANY(worst > NEARLY); /* Newton squares the error: one more step leaves rounding */
        solve(J, step);
        limit(step);
        for (i = 0; i < 3; i++) w[i] = zero;
        for (i = 0; i < fixed; i++) q[i] += step[i];
        for (c = 0; c < M - fixed; c++) {
            const int state = inverse ? FREE[c] : c;
            if (state >= ND) phi[state - ND] += step[fixed + c];
            else if (DOF[state] < 3) p[DOF[state]] += step[fixed + c];
            else w[DOF[state] - 3] = step[fixed + c];
        }
        exp3(w, turn);
        matmul3(turn, R, turned);
        for (i = 0; i < 9; i++) R[i] = turned[i];
        if (inverse && KEEP_YAW) keep_yaw(R, R0);
        if (inverse) base_side(q, warm, at);
        if (H > 0) plate_side(phi, at->b);
        worst = close_loops(p, R, reference, at);
    }
    orthonormal(R);
    return worst;
}

/* Positive on the working branch: the plate is not turned over, and rods stand on their side. */
static real margin(const closure *at, const real R[9], const real R0[9])
{
    real out = {0.0};
    int r, i;
    if (TILT_FREE == 1) out = R[2] * R0[2] + R[5] * R0[5] + R[8] * R0[8] - cos(MAX_TILT);
    else if (TILT_FREE == 2) {
        for (i = 0; i < 9; i++) out += 0.5 * R[i] * R0[i];
        out += -0.5 - cos(MAX_TILT);
    } else out += 1.0;
    for (r = 0; r < M; r++) {
        const real side = at->n[r][2] * ROD_SIDE;
        if (!GUIDED[r] && ROD_SIDE != 0) out = SELECT(side < out, side, out);
    }
    return out;
}

/* Closed-form commands for a plate pose, the mean over each actuator's rods; NaN where a rod does not reach. */
static void first_commands(const real x[3], const real R[9], const closure *at, real q[NQ])
{
    const real zero = {0.0};
    real along[NQ], across[NQ], sum[NQ]; /* directions of arms are added as vectors, what slides as numbers */
    int turns[NQ], count[NQ], r, i;
    for (i = 0; i < NQ; i++) along[i] = across[i] = sum[i] = zero, turns[i] = count[i] = 0;
    for (r = 0; r < M; r++) {
        const int a = ACTUATOR[r];
        const double size = DOT(COSINE[r], COSINE[r]), speed = DOT(SLOPE[r], SLOPE[r]);
        real B[3], d[3], square;
        turn3(R, at->b[r], B);
        for (i = 0; i < 3; i++) d[i] = x[i] + B[i] - CENTRE[r][i];
        square = DOT(d, d);
        if (GUIDED[r]) { /* the rod that the drive turns reaches the commanded x */
            const double c = GUIDE_COSINE[r][0], s = GUIDE_SINE[r][0], whole = sqrt(c * c + s * s);
            const real sine = d[0] / (GUIDE_LENGTH[r] * whole), cosine = SQRT(1.0 - sine * sine);
            along[a] += (c * cosine - s * sine) / whole;
            across[a] += (s * cosine + c * sine) / whole;
            turns[a] = 1;
        } else if (size > 0.0) { /* |d - C cos q - S sin q| = l, with C and S normal and of one size */
            const real e = DOT(d, COSINE[r]), f = DOT(d, SINE[r]), both = e * e + f * f;
            const real g = 0.5 * (square + size - LENGTH[r] * LENGTH[r]), root = SQRT(both - g * g);
            along[a] += (e * g - f * root) / both;
            across[a] += (f * g + e * root) / both;
            turns[a] = 1;
        } else if (RATE[r] != 0.0) {
            sum[a] += (SQRT(square) - LENGTH[r]) / RATE[r];
        } else if (speed > 0.0) { /* the carriage ahead of the plate on its rail is the working branch */
            const real on = DOT(d, SLOPE[r]);
            sum[a] += (on + SQRT(on * on - speed * (square - LENGTH[r] * LENGTH[r]))) / speed;
        } else continue;
        count[a]++;
    }
    for (i = 0; i < NQ; i++) q[i] = turns[i] ? ATAN2(across[i], along[i]) : sum[i] / count[i];
}
