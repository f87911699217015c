/* ---- rods between anchors: Newton on the closed loops ------------------------------------------------------------
 *
 * Rod r joins a base-side anchor A, moved by one actuator, to a plate-side anchor B:
 *
 *     A = O + C cos q + S sin q + D q        B = x + R b        f = |B - A| - l = 0
 *
 * A guided row has a direction n that its actuator prescribes, and f = n . (B - A). The plate may carry further bodies
 * on hinges. All loops are bounded, nothing is allocated, and nothing is kept between calls.
 */

typedef struct {
    double d[M][3];  /* B - A */
    double n[M][3];  /* unit direction, or guide */
    double r[M][3];  /* B minus the reference point, base frame */
    double dA[M][3]; /* derivative of A by q */
    double dn[M][3]; /* derivative of a guide by q */
    double dl[M];    /* derivative of the length by q */
    double f[M];     /* loop error */
} closure;

static double dot3(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross3(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void turn3(const double R[9], const double v[3], double out[3])
{
    int i;
    for (i = 0; i < 3; i++) out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}

static void matmul3(const double A[9], const double B[9], double out[9])
{
    int i, j;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) out[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}

/* Rotation matrix of a rotation vector (Rodrigues). */
static void exp3(const double w[3], double R[9])
{
    const double a2 = dot3(w, w), a = sqrt(a2);
    const double s = a < 1e-4 ? 1.0 - a2 / 6.0 : sin(a) / a;
    const double c = a < 1e-4 ? 0.5 - a2 / 24.0 : (1.0 - cos(a)) / a2;
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
static void orthonormal(double R[9])
{
    double s = sqrt(dot3(R, R));
    int i;
    for (i = 0; i < 3; i++) R[i] /= s;
    s = dot3(R, R + 3);
    for (i = 0; i < 3; i++) R[3 + i] -= s * R[i];
    s = sqrt(dot3(R + 3, R + 3));
    for (i = 0; i < 3; i++) R[3 + i] /= s;
    cross3(R, R + 3, R + 6);
}

/* What temperatures do: lengths in proportion to what is given above 20 degrees. */
typedef struct {
    double rods, arms, base;
} warming;

static warming warmer(const pcalib_conditions *at)
{
    warming out = {0.0, 0.0, 0.0};
    if (at) {
        out.rods = at->temp_rods - 20.0;
        out.arms = at->temp_arms - 20.0;
        out.base = at->temp_base - 20.0;
    }
    return out;
}

/* Base-side anchors A and lengths l, with their derivatives by q, of every rod. */
static void base_side(const double q[NQ], const warming *warm, double A[M][3], double l[M], closure *at)
{
    double c[NQ], s[NQ], true_q[NQ], rate[NQ], c0[NQ], s0[NQ];
    int i, r, w;
    for (i = 0; i < NQ; i++) {
        true_q[i] = q[i] * (1.0 + RATIO[i]);
        rate[i] = 1.0 + RATIO[i];
        for (w = 0; w < WAVES; w++) {
            const double n = CYCLES[w];
            true_q[i] += WAVE_SINE[w][i] * sin(n * q[i]) + WAVE_COSINE[w][i] * cos(n * q[i]);
            rate[i] += n * (WAVE_SINE[w][i] * cos(n * q[i]) - WAVE_COSINE[w][i] * sin(n * q[i]));
        }
        c[i] = TURNS ? cos(true_q[i]) : 1.0;
        s[i] = TURNS ? sin(true_q[i]) : 0.0;
        c0[i] = TURNS && ARMS_GROW ? cos(q[i]) : 1.0;
        s0[i] = TURNS && ARMS_GROW ? sin(q[i]) : 0.0;
    }
    for (r = 0; r < M; r++) {
        const int a = ACTUATOR[r];
        const double arm = ARMS_GROW ? ARM_GROWTH[r] * warm->arms : 0.0;
        for (i = 0; i < 3; i++) {
            A[r][i] = CENTRE[r][i] + COSINE[r][i] * c[a] + SINE[r][i] * s[a] + SLOPE[r][i] * true_q[a];
            at->dA[r][i] = rate[a] * (SINE[r][i] * c[a] - COSINE[r][i] * s[a] + SLOPE[r][i]);
            if (ARMS_GROW) { /* the arm grows from its base point, at the commanded angle */
                const double out = CENTRE[r][i] + COSINE[r][i] * c0[a] + SINE[r][i] * s0[a] + SLOPE[r][i] * q[a];
                A[r][i] += arm * (out - PIVOT[r][i]);
                at->dA[r][i] += arm * (SINE[r][i] * c0[a] - COSINE[r][i] * s0[a] + SLOPE[r][i]);
            }
            if (BASE_GROWS) A[r][i] += BASE_GROWTH[r] * warm->base * PIVOT[r][i];
            at->n[r][i] = GUIDED[r] ? GUIDE_COSINE[r][i] * c[a] + GUIDE_SINE[r][i] * s[a] : 0.0;
            at->dn[r][i] = GUIDED[r] ? rate[a] * (GUIDE_SINE[r][i] * c[a] - GUIDE_COSINE[r][i] * s[a]) : 0.0;
        }
        l[r] = LENGTH[r] + RATE[r] * true_q[a];
        at->dl[r] = RATE[r] * rate[a];
        if (RODS_GROW) {
            l[r] += ROD_GROWTH[r] * warm->rods * (LENGTH[r] + RATE[r] * q[a]);
            at->dl[r] += ROD_GROWTH[r] * warm->rods * RATE[r];
        }
    }
}

/* Plate-side anchors in the plate frame, hinges turned by phi. */
static void plate_side(const double *phi, double b[M][3])
{
    int r, i;
    for (r = 0; r < M; r++) {
        for (i = 0; i < 3; i++) b[r][i] = PLATE[r][i];
#if H > 0
        if (BODY[r]) {
            const int h = BODY[r] - 1;
            double w[3], R[9], arm[3], out[3];
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

/* The closure with the reference point (plate frame) at p; the largest loop error. */
static double close_loops(
    const double q[NQ], const warming *warm, const double p[3], const double R[9], const double *phi,
    const double reference[3], double b[M][3], closure *at)
{
    double A[M][3], l[M], arm[3], worst = 0.0;
    int r, i;
    base_side(q, warm, A, l, at);
    plate_side(phi, b);
    for (r = 0; r < M; r++) {
        double size;
        for (i = 0; i < 3; i++) arm[i] = b[r][i] - reference[i];
        turn3(R, arm, at->r[r]);
        for (i = 0; i < 3; i++) at->d[r][i] = p[i] + at->r[r][i] - A[r][i];
        if (GUIDED[r]) {
            at->f[r] = dot3(at->n[r], at->d[r]) - l[r];
        } else {
            size = sqrt(dot3(at->d[r], at->d[r]));
            for (i = 0; i < 3; i++) at->n[r][i] = at->d[r][i] / size;
            at->f[r] = size - l[r];
        }
        if (!(fabs(at->f[r]) <= worst)) worst = fabs(at->f[r]); /* NaN stays */
    }
    return worst;
}

/* Derivative of f_r by component c of the plate's state: twist at the reference point, then hinge angles. */
static double by_state(const closure *at, const double R[9], double b[M][3], int r, int c)
{
    double v[3];
    if (c < ND) {
        const int d = DOF[c];
        if (d < 3) return at->n[r][d];
        cross3(at->r[r], at->n[r], v);
        return v[d - 3];
    }
#if H > 0
    if (BODY[r] == c - ND + 1) {
        double arm[3], swing[3];
        int i;
        for (i = 0; i < 3; i++) arm[i] = b[r][i] - HINGE_POINT[c - ND][i];
        cross3(HINGE_AXIS[c - ND], arm, v);
        turn3(R, v, swing);
        return dot3(at->n[r], swing);
    }
#else
    (void)R;
    (void)b;
#endif
    return 0.0;
}

static double by_actuator(const closure *at, int r)
{
    const double rate = -dot3(at->n[r], at->dA[r]) - at->dl[r];
    return GUIDED[r] ? rate + dot3(at->dn[r], at->d[r]) : rate;
}

/* x with A x = y, by elimination with pivots; 0 where A is singular. A and y are overwritten, y becomes x. */
static int solve(double A[M][M], double y[M])
{
    int i, j, k;
    for (k = 0; k < M; k++) {
        int best = k;
        for (i = k + 1; i < M; i++)
            if (fabs(A[i][k]) > fabs(A[best][k])) best = i;
        if (!(fabs(A[best][k]) > 1e-14)) return 0;
        if (best != k) {
            double t;
            for (j = k; j < M; j++) t = A[k][j], A[k][j] = A[best][j], A[best][j] = t;
            t = y[k], y[k] = y[best], y[best] = t;
        }
        for (i = k + 1; i < M; i++) {
            const double factor = A[i][k] / A[k][k];
            for (j = k + 1; j < M; j++) A[i][j] -= factor * A[k][j];
            y[i] -= factor * y[k];
        }
    }
    for (k = M - 1; k >= 0; k--) {
        for (j = k + 1; j < M; j++) y[k] -= A[k][j] * y[j];
        y[k] /= A[k][k];
    }
    return 1;
}

/* Steps of at most half a metre or radian, so that a far start does not jump to another branch. */
static void limit(double step[M])
{
    double most = 0.0;
    int i;
    for (i = 0; i < M; i++)
        if (fabs(step[i]) > most) most = fabs(step[i]);
    if (most > 0.5)
        for (i = 0; i < M; i++) step[i] *= 0.5 / most;
}

static int status_of(const closure *at, double worst, const double R[9], const double R0[9])
{
    int r, i;
    double upright = 1.0;
    if (!(worst <= 1e-9)) return PCALIB_NOT_CONVERGED;
    if (TILT_FREE == 1) upright = R[2] * R0[2] + R[5] * R0[5] + R[8] * R0[8];
    if (TILT_FREE == 2) {
        upright = -0.5;
        for (i = 0; i < 9; i++) upright += 0.5 * R[i] * R0[i];
    }
    if (upright < cos(MAX_TILT)) return PCALIB_WRONG_BRANCH;
    for (r = 0; ROD_SIDE && r < M; r++)
        if (!GUIDED[r] && at->n[r][2] * ROD_SIDE <= 0.0) return PCALIB_WRONG_BRANCH;
    return PCALIB_OK;
}

/* Where a forward solution starts: a polynomial of second degree that was fitted over the workspace. */
static void start(const double q[NQ], double x[3], double R[9], double *phi)
{
    double u[NQ], v[6 + H];
    int i, j, c;
    for (i = 0; i < NQ; i++) u[i] = (q[i] - 0.5 * (Q_MAX + Q_MIN)) / (0.5 * (Q_MAX - Q_MIN));
    for (c = 0; c < 6 + H; c++) {
        const double *term = START[c];
        v[c] = *term++;
        for (i = 0; i < NQ; i++) v[c] += *term++ * u[i];
        for (i = 0; i < NQ; i++)
            for (j = i; j < NQ; j++) v[c] += *term++ * u[i] * u[j];
    }
    for (i = 0; i < 3; i++) x[i] = v[i];
    exp3(v + 3, R);
#if H > 0
    for (i = 0; i < H; i++) phi[i] = v[6 + i];
#else
    (void)phi;
#endif
}

int pcalib_forward(const double q[NQ], const double tool[3], const pcalib_conditions *conditions, pcalib_pose *pose)
{
    static const double origin[3] = {0.0, 0.0, 0.0}, identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const warming warm = warmer(conditions);
    double x[3], R[9], phi[H + 1], b[M][3], arm[3], worst;
    closure at;
    int round, last, i, r, c;
    start(q, x, R, phi);
    worst = close_loops(q, &warm, x, R, phi, origin, b, &at);
    for (round = 0, last = 0; round < ROUNDS && !last && worst < 1e6; round++) {
        double J[M][M], step[M], w[3] = {0.0, 0.0, 0.0}, turn[9], turned[9];
        for (r = 0; r < M; r++) {
            for (c = 0; c < M; c++) J[r][c] = by_state(&at, R, b, r, c);
            step[r] = -at.f[r];
        }
        last = worst <= NEARLY; /* Newton squares the error: one more step leaves rounding */
        if (!solve(J, step)) break;
        limit(step);
        for (c = 0; c < ND; c++) {
            if (DOF[c] < 3) x[DOF[c]] += step[c];
            else w[DOF[c] - 3] = step[c];
        }
        for (i = 0; i < H; i++) phi[i] += step[ND + i];
        exp3(w, turn);
        matmul3(turn, R, turned);
        memcpy(R, turned, sizeof turned);
        worst = close_loops(q, &warm, x, R, phi, origin, b, &at);
    }
    orthonormal(R);
    turn3(R, tool, arm);
    for (i = 0; i < 3; i++) pose->plate[i] = x[i], pose->position[i] = x[i] + arm[i];
    memcpy(pose->rotation, R, sizeof R);
    return status_of(&at, worst, R, identity);
}

/* Closed-form commands for a plate pose, the mean over each actuator's rods; 0 where a rod does not reach. */
static int first_commands(const double x[3], const double R[9], double b[M][3], double q[NQ])
{
    double sum[NQ], count[NQ];
    int r, i;
    for (i = 0; i < NQ; i++) sum[i] = count[i] = 0.0;
    for (r = 0; r < M; r++) {
        double B[3], d[3], value;
        if (GUIDED[r]) { /* the rod that the drive turns reaches the commanded x */
            const double c = GUIDE_COSINE[r][0], s = GUIDE_SINE[r][0];
            turn3(R, b[r], B);
            value = (x[0] + B[0] - CENTRE[r][0]) / (GUIDE_LENGTH[r] * sqrt(c * c + s * s));
            if (!(fabs(value) <= 1.0)) return 0;
            sum[ACTUATOR[r]] += asin(value) + atan2(s, c);
            count[ACTUATOR[r]] += 1.0;
            continue;
        }
        if ( (!TURNS && RATE[r] == 0.0 && dot3(SLOPE[r], SLOPE[r]) == 0.0)) continue;
        if (TURNS && dot3(COSINE[r], COSINE[r]) == 0.0 && RATE[r] == 0.0) continue;
        turn3(R, b[r], B);
        for (i = 0; i < 3; i++) d[i] = x[i] + B[i] - CENTRE[r][i];
        if (dot3(COSINE[r], COSINE[r]) > 0.0) { /* |d - C cos q - S sin q| = l, with C and S normal and of one size */
            const double e = dot3(d, COSINE[r]), f = dot3(d, SINE[r]);
            const double g = 0.5 * (dot3(d, d) + dot3(COSINE[r], COSINE[r]) - LENGTH[r] * LENGTH[r]);
            const double share = g / sqrt(e * e + f * f);
            if (!(fabs(share) <= 1.0)) return 0;
            value = atan2(f, e) + acos(share);
            while (value > PI) value -= 2.0 * PI;
            while (value <= -PI) value += 2.0 * PI;
        } else if (RATE[r] != 0.0) {
            value = (sqrt(dot3(d, d)) - LENGTH[r]) / RATE[r];
        } else { /* the carriage ahead of the plate on its rail is the working branch */
            const double along = dot3(d, SLOPE[r]), speed = dot3(SLOPE[r], SLOPE[r]);
            const double root = along * along - speed * (dot3(d, d) - LENGTH[r] * LENGTH[r]);
            if (!(root >= 0.0)) return 0;
            value = (along + sqrt(root)) / speed;
        }
        sum[ACTUATOR[r]] += value;
        count[ACTUATOR[r]] += 1.0;
    }
    for (i = 0; i < NQ; i++) q[i] = count[i] > 0.0 ? sum[i] / count[i] : 0.5 * (Q_MIN + Q_MAX);
    return 1;
}

int pcalib_inverse(
    const double position[3], const double *rotation, const double tool[3], const pcalib_conditions *conditions,
    double q[NQ])
{
    static const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const warming warm = warmer(conditions);
    const double *R0 = rotation ? rotation : identity;
    double p[3], R[9], phi[H + 1], b[M][3], x[3], arm[3], worst;
    closure at;
    int round, last, i, r, c, status;
    memcpy(R, R0, sizeof R);
#if H > 0
    for (i = 0; i < H; i++) { /* hinged bodies stay nearest to their turn at R = I, as parallel rods hold them */
        const double v[3] = {R[7] - R[5], R[2] - R[6], R[3] - R[1]};
        phi[i] = -2.0 * atan2(dot3(v, HINGE_AXIS[i]), 1.0 + R[0] + R[4] + R[8]);
    }
#endif
    turn3(R, tool, arm);
    for (i = 0; i < 3; i++) p[i] = position[i], x[i] = p[i] - arm[i];
    plate_side(phi, b);
    if (!first_commands(x, R, b, q)) return PCALIB_NOT_CONVERGED;
    if (LOOSE) { /* a translation that no command prescribes is solved for */
        double near[3], turned[9], carried[3], ignored[H + 1];
        start(q, near, turned, ignored);
        turn3(turned, tool, carried);
        for (i = 0; i < 3; i++)
            if (LOOSE & (1 << i)) p[i] = near[i] + carried[i];
    }
    worst = close_loops(q, &warm, p, R, phi, tool, b, &at);
    for (round = 0, last = 0; round < ROUNDS && !last && worst < 1e6; round++) {
        double J[M][M], step[M], w[3] = {0.0, 0.0, 0.0}, turn[9], turned[9];
        for (r = 0; r < M; r++) {
            for (i = 0; i < NQ; i++) J[r][i] = ACTUATOR[r] == i ? by_actuator(&at, r) : 0.0;
            for (c = 0; c < M - NQ; c++) J[r][NQ + c] = by_state(&at, R, b, r, FREE[c]);
            step[r] = -at.f[r];
        }
        last = worst <= NEARLY; /* Newton squares the error: one more step leaves rounding */
        if (!solve(J, step)) break;
        limit(step);
        for (i = 0; i < NQ; i++) q[i] += step[i];
        for (c = 0; c < M - NQ; c++) {
            const int state = FREE[c];
            if (state >= ND) phi[state - ND] += step[NQ + c];
            else if (DOF[state] < 3) p[DOF[state]] += step[NQ + c];
            else w[DOF[state] - 3] = step[NQ + c];
        }
        exp3(w, turn);
        matmul3(turn, R, turned);
        memcpy(R, turned, sizeof turned);
        if (KEEP_YAW) { /* the twist about the base's z axis stays the commanded one */
            const double yaw = 2.0 * (atan2(R0[3] - R0[1], 1.0 + R0[0] + R0[4] + R0[8])
                                      - atan2(R[3] - R[1], 1.0 + R[0] + R[4] + R[8]));
            const double Z[9] = {cos(yaw), -sin(yaw), 0, sin(yaw), cos(yaw), 0, 0, 0, 1};
            matmul3(R, Z, turned);
            memcpy(R, turned, sizeof turned);
        }
        worst = close_loops(q, &warm, p, R, phi, tool, b, &at);
    }
    status = status_of(&at, worst, R, R0);
    for (i = 0; i < NQ && status == PCALIB_OK; i++)
        if (q[i] < Q_MIN - 1e-9 || q[i] > Q_MAX + 1e-9) status = PCALIB_OUTSIDE_JOINT_RANGE;
    return status;
}
