/* Walks with forward sensitivities: stands behind driver.c where something is free.

   Rows of length LD, one column per free parameter or start state. NS of the NX states have a row: those in KEPT, where
   nothing that is measured depends on the others. */

/* d mean / d Td = (u(a) - u(b)) / h of inputs that are linear in between: held ones are constant in a step. */
static void mean_input_rates(Run *run, double t, double h, double *rate) {
  for (int m = 0; m < ND; m++) {
    int j = DEAD_INPUT[m];
    double a = t - delay_of(run, j), slope;
    rate[m] = LINEAR[j] ? (input_at(run, j, a, 0, &slope) - input_at(run, j, a + h, 0, &slope)) / h : 0.0;
  }
}

static void input_rates_at_sample(Run *run, long long k, double *rate) {
  for (int m = 0; m < ND; m++) {
    double slope;
    input_at(run, DEAD_INPUT[m], run->time[k] - delay_of(run, DEAD_INPUT[m]), 0, &slope);
    rate[m] = -slope;
  }
}

/* Rows of a sparse matrix times the seeds, and single entries added to them; see source.py. */
#define SEED(j) dx[(j) * LD + c]
#define ROW(i, sum) \
  for (int c = 0; c < LD; c++) rows[(i) * LD + c] = sum;

/* One stage: xdot and its derivative to theta, rows = d xdot / d theta, at (x, dx); fx: nonzeros of df/dx. */
static void linear_stage(Run *run, double t, const double *x, const double *u, const double *restrict dx,
                         const double *du, double *xdot, double *restrict rows, double *fx) {
  double fp[FP_NNZ + 1], fu[FU_NNZ + 1];
  const double *arg[RATE_ARG] = {&t, x, u, run->p};
  double *res[RATE_RES] = {xdot, fx, fp, fu};
  linear_rate(arg, res, run->integers, run->work, 0);
#define ENTRY(e) fx[e]
#define ADD_P(e, i, j) rows[(i) * LD + (j)] += fp[e];
#define ADD_U(e, i, j) rows[(i) * LD + DEAD_COLUMN[j]] += fu[e] * du[j];
  FX_ROWS(ROW) FP_EACH(ADD_P) FU_EACH(ADD_U)
#undef ENTRY
#undef ADD_P
#undef ADD_U
}

#if ND > 0
static void rates_at(Run *run, double t, const double *x, const double *u, double *xdot) {
  double fx[FX_NNZ + 1], fp[FP_NNZ + 1], fu[FU_NNZ + 1];
  const double *arg[RATE_ARG] = {&t, x, u, run->p};
  double *res[RATE_RES] = {xdot, fx, fp, fu};
  linear_rate(arg, res, run->integers, run->work, 0);
}

/* Where late inputs jump at t, a longer dead time means the slope of before for a while, not that of behind. */
static void derive_jumps(Run *run, long long k, double t, const double *x, double *dx) {
  double behind[NU + 1], before[NU + 1], slopes[NU + 1], slope, rate[2][NX + 1];
  inputs_behind(run, k, t, behind, slopes);
  for (int m = 0; m < ND; m++) {
    int c = DEAD_COLUMN[m], known = 0, jumps = 0;
    for (int n = 0; n < m; n++) known |= DEAD_COLUMN[n] == c;
    memcpy(before, behind, NU * sizeof(double));
    for (int n = m; n < ND; n++)
      if (DEAD_COLUMN[n] == c) {
        int j = DEAD_INPUT[n];
        if (!LINEAR[j]) before[j] = input_at(run, j, t - delay_of(run, j), 0, &slope);
        jumps |= before[j] != behind[j];
      }
    if (known || !jumps) continue;
    rates_at(run, t, x, before, rate[0]);
    rates_at(run, t, x, behind, rate[1]);
    for (int i = 0; i < NS; i++) dx[i * LD + c] += rate[0][KEPT[i]] - rate[1][KEPT[i]];
  }
}
#endif

static inline void combine(int n, double *restrict to, const double *restrict from, double factor,
                           const double *restrict rate) {
  for (int i = 0; i < n; i++) to[i] = from[i] + factor * rate[i];
}

static inline void weigh(int n, double *restrict to, const double *restrict x, double h, const double *restrict k1,
                         const double *restrict k2, const double *restrict k3, const double *restrict k4) {
  for (int i = 0; i < n; i++) to[i] = x[i] + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

#if IMPLICIT /* in implicit.c */
static Step step_tangent;
#else
static int step_tangent(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  const double *x = z, *dx = z + NX;
  double u[NU + 1], du[ND + 1];
  double k1[NX + 1], k2[NX + 1], k3[NX + 1], k4[NX + 1], xs[NX + 1], roughness[NX + 1], fx[FX_NNZ + 1];
  double d1[NS * LD + 1], d2[NS * LD + 1], d3[NS * LD + 1], d4[NS * LD + 1], ds[NS * LD + 1];
  mean_inputs(run, k, t, h, whole, u);
  mean_input_rates(run, t, h, du);
  linear_stage(run, t, x, u, dx, du, k1, d1, fx);
  combine(NX, xs, x, h / 2, k1);
  combine(NS * LD, ds, dx, h / 2, d1);
  linear_stage(run, t + h / 2, xs, u, ds, du, k2, d2, fx);
  combine(NX, xs, x, h / 2, k2);
  combine(NS * LD, ds, dx, h / 2, d2);
  linear_stage(run, t + h / 2, xs, u, ds, du, k3, d3, fx);
  combine(NX, xs, x, h, k3);
  combine(NS * LD, ds, dx, h, d3);
  linear_stage(run, t + h, xs, u, ds, du, k4, d4, fx);
  weigh(NX, next, x, h, k1, k2, k3, k4);
  for (int i = 0; i < NX; i++) { /* as in rk4_substep */
    double bend = k1[i] - k2[i] - k3[i] + k4[i], turn = 2 * (k3[i] - k2[i]);
    roughness[i] = h * h / 36 * (bend * bend + turn * turn);
  }
  weigh(NS * LD, next + NX, dx, h, d1, d2, d3, d4);
  return judged(run, x, next, roughness);
}
#endif

/* dy = dh/dx dx + dh/dp + dh/du du at sample k. */
static int write_linear_output(Run *run, long long k, const double *x, const double *dx, double *y, double *dy) {
  double u[NU + 1], du[ND + 1], hx[HX_NNZ + 1], hp[HP_NNZ + 1], hu[HU_NNZ + 1], rows[NY * LD + 1];
  const double *arg[SEEN_ARG] = {run->time + k, x, u, run->p};
  double *res[SEEN_RES] = {y, hx, hp, hu};
  inputs_at_sample(run, k, u);
  input_rates_at_sample(run, k, du);
  linear_output(arg, res, run->integers, run->work, 0);
#define ENTRY(e) hx[e]
#define ADD_P(e, i, j) rows[(i) * LD + (j)] += hp[e];
#define ADD_U(e, i, j) rows[(i) * LD + DEAD_COLUMN[j]] += hu[e] * du[j];
  HX_ROWS(ROW) HP_EACH(ADD_P) HU_EACH(ADD_U)
  for (int i = 0; i < NY; i++) memcpy(dy + i * NT, rows + i * LD, NT * sizeof(double));
  return not_finite(y, NY) ? 2 : 0;
}

/* Squares, their gradient and the upper triangle of their Gauss-Newton Hessian gain what sample k leaves. */
static void add_expansion(Sum *sum, long long k, const double *y, const double *restrict dy) {
  double r;
  for (int i = 0; i < NY; i++) {
    if (!residual(sum, k, i, y, &r)) continue;
    const double *restrict row = dy + i * NT;
    double *restrict gradient = sum->gradient + i * NT, *restrict hessian = sum->hessian + i * NT * NT;
    sum->squares[i] += r * r;
    sum->beyond |= sum->limit && sum->squares[i] > sum->limit[i];
    for (int c = 0; c < NT; c++) {
      gradient[c] += r * row[c];
      for (int d = c; d < NT; d++) hessian[c * NT + d] += row[c] * row[d];
    }
  }
}

/* One run with sensitivities; as `walk`. */
static int walk_tangent(Run *run, const double *x0, const double *dx0, double *y, double *dy, double *x_out,
                        double *dx_out, Sum *sum, double *where) {
  const double *time = run->time;
  double x[MOVING + 1], *dx = x + NX;
  int status = open_run(run);
  FLUSH();
  memcpy(x, x0, NX * sizeof(double));
  memset(dx, 0, NS * LD * sizeof(double));
  for (int i = 0; i < NS; i++) memcpy(dx + i * LD, dx0 + KEPT[i] * NT, NT * sizeof(double));
  for (long long k = 0; k < run->samples && !status; k++) {
    long long row = sum ? 0 : k;
    memcpy(x_out + row * NX, x, NX * sizeof(double));
    for (int i = 0; dx_out && i < NS; i++)
      memcpy(dx_out + (row * NX + KEPT[i]) * NT, dx + i * LD, NT * sizeof(double));
    if ((status = write_linear_output(run, k, x, dx, y + row * NY, dy + row * NY * NT)))
      stopped(status, time[k], x, where);
    if (sum) add_expansion(sum, k, y, dy);
    if (sum && sum->beyond) status = 1;
    if (k + 1 == run->samples || status) break;
    if ((status = cross(run, step_tangent, MOVING, k, x))) stopped(status, run->reached, x, where);
  }
  close_run(run);
  RESTORE();
  return status;
}

/* dx0 (NX, NT); y (samples, NY), dy (samples, NY, NT), x (samples, NX), dx (samples, NX, NT; rows KEPT) or null. */
EXPORT int propagate_tangent(long long samples, const double *time, const double *u, const double *p, Control control,
                             const double *x0, const double *dx0, double *y, double *dy, double *x_out,
                             double *dx_out, double *where) {
  Run run = {samples, time, u, p, control};
  return walk_tangent(&run, x0, dx0, y, dy, x_out, dx_out, 0, where);
}

/* dx0 (segments, NX, NT); sums by output, all zero before: squares (segments, NY), their gradient (segments, NY, NT) and
   hessian (segments, NY, NT, NT), both halved; squares are not a number where a run stopped or one of them passed its
   limit (segments, NY; or null), infinite where it became dear. */
EXPORT void propagate_expansions(long long segments, const long long *cuts, const double *time, const double *u,
                                 const double *p, Control control, const double *x0, const double *dx0,
                                 const double *measured, const double *limits, double *squares, double *gradient,
                                 double *hessian) {
  double y[NY + 1], dy[NY * NT + 1], x[NX + 1], where[NX + 1];
  for (long long s = 0; s < segments; s++) {
    Run run = run_of(cuts + 3 * s, time, u, p, control);
    Sum sum = sum_of(cuts + 3 * s, measured, 0, limits ? limits + s * NY : 0);
    sum.squares = squares + s * NY, sum.gradient = gradient + s * NY * NT, sum.hessian = hessian + s * NY * NT * NT;
    int status = walk_tangent(&run, x0 + s * NX, dx0 + s * NX * NT, y, dy, x, 0, &sum, where);
    for (int i = 0; i < NY; i++) {
      double *H = sum.hessian + i * NT * NT;
      if (status || sum.squares[i] == INFINITY) sum.squares[i] = status == DEAR ? INFINITY : NAN;
      for (int c = 0; c < NT; c++)
        for (int d = 0; d < c; d++) H[c * NT + d] = H[d * NT + c];
    }
  }
}
