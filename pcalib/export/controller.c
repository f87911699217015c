
/* ---- what a controller calls ------------------------------------------------------------------------------------- */

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

static int status_of(const closure *at, double worst, const double R[9], const double R0[9])
{
    if (!(worst <= 1e-9)) return PCALIB_NOT_CONVERGED;
    return margin(at, R, R0) > 0.0 ? PCALIB_OK : PCALIB_WRONG_BRANCH;
}

int pcalib_forward(const double q[NQ], const double tool[3], const pcalib_conditions *conditions, pcalib_pose *pose)
{
    static const double origin[3] = {0.0, 0.0, 0.0}, identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const warming warm = warmer(conditions);
    double command[NQ], x[3], R[9], phi[H + 1], arm[3], worst;
    closure at;
    int i;
    memcpy(command, q, sizeof command);
    start(q, x, R, phi);
    base_side(q, &warm, &at);
    plate_side(phi, at.b);
    worst = newton(0, CLOSE, command, &warm, x, R, phi, origin, identity, &at);
    turn3(R, tool, arm);
    for (i = 0; i < 3; i++) pose->plate[i] = x[i], pose->position[i] = x[i] + arm[i];
    memcpy(pose->rotation, R, sizeof R);
    return status_of(&at, worst, R, identity);
}

int pcalib_inverse(
    const double position[3], const double *rotation, const double tool[3], const pcalib_conditions *conditions,
    double q[NQ])
{
    static const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const warming warm = warmer(conditions);
    const double *R0 = rotation ? rotation : identity;
    double p[3], R[9], phi[H + 1], x[3], arm[3], worst;
    closure at;
    int i, status;
    memcpy(R, R0, sizeof R);
    level(R, phi);
    turn3(R, tool, arm);
    for (i = 0; i < 3; i++) p[i] = position[i], x[i] = p[i] - arm[i];
    plate_side(phi, at.b);
    first_commands(x, R, &at, q);
    base_side(q, &warm, &at);
    if (LOOSE) { /* a translation that no command prescribes is solved for */
        double near[3], turned[9], carried[3], ignored[H + 1];
        start(q, near, turned, ignored);
        turn3(turned, tool, carried);
        for (i = 0; i < 3; i++)
            if (LOOSE & (1 << i)) p[i] = near[i] + carried[i];
    }
    worst = newton(1, CLOSE, q, &warm, p, R, phi, tool, R0, &at);
    status = status_of(&at, worst, R, R0);
    for (i = 0; i < NQ && status == PCALIB_OK; i++)
        if (q[i] < Q_MIN - 1e-9 || q[i] > Q_MAX + 1e-9) status = PCALIB_OUTSIDE_JOINT_RANGE;
    return status;
}
