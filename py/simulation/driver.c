/* Walks the samples of one recording through one model.

   Generated in front of this text: the sizes (NX states, NS of them with sensitivities, NU inputs, NP parameters, NY
   outputs, NT sensitivities, LD = NT rounded up), the sparse products of the sensitivities as macros, and the CasADi functions

     rk4_substep  (t, x, u, p, h) -> x          or  implicit_substep (t, x, u, p, h) -> x
     output       (t, x, u, p) -> y
     linear_rate  (t, x, u, p) -> x', df/dx, df/dp, df/du      (nonzeros only)
     linear_output(t, x, u, p) -> y , dh/dx, dh/dp, dh/du
     implicit_tangent (t, x, u, p, h, dx, du) -> dx             (implicit method only)

   Status: 0 done; 1 a state, 2 an output left the finite numbers; 3 the implicit method gave up; 4 out of memory. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Derivatives to a start decay for ever. Numbers below 1e-308 make a processor ten times slower and mean nothing: zero.
   FLUSH begins a run, RESTORE gives the caller's mode back. */
#if defined(__SSE2__) && defined(__GNUC__) /* the header that names these takes a tenth of the compiler's time */
#define FLUSH() unsigned int caller_mode = __builtin_ia32_stmxcsr(); __builtin_ia32_ldmxcsr(caller_mode | 0x8040u)
#define RESTORE() __builtin_ia32_ldmxcsr(caller_mode)
#else
#define FLUSH()
#define RESTORE()
#endif

typedef struct {
  long long samples;
  const double *time, *u, *p;
  double step;
  long long cursor[NU + 1];
  double *work; /* of the generated functions */
  casadi_int *integers;
} Run;

/* ---- inputs: held or linear between samples, delayed by a parameter, first value before the first sample ---- */

static double delay_of(const Run *run, int j) { return DELAY[j] < 0 ? 0.0 : run->p[DELAY[j]]; }

/* Index i of the piece [t_i, t_{i+1}) that holds time a; the cursor remembers it for the next call. */
static long long piece_at(Run *run, int j, double a) {
  long long i = run->cursor[j];
  while (i > 0 && run->time[i] > a) i--;
  while (i + 1 < run->samples && run->time[i + 1] <= a) i++;
  return run->cursor[j] = i;
}

static double slope_on(const Run *run, int j, long long i) {
  if (!LINEAR[j] || i + 1 >= run->samples) return 0.0;
  return (run->u[(i + 1) * NU + j] - run->u[i * NU + j]) / (run->time[i + 1] - run->time[i]);
}

/* Mean of input j over [a, b]: exact for held and for linear inputs. */
static double input_mean(Run *run, int j, double a, double b) {
  const double *time = run->time, *u = run->u + j;
  double integral = 0.0, length = b - a;
  long long i;
  if (b <= time[0]) return u[0];
  if (a < time[0]) {
    integral = (time[0] - a) * u[0];
    a = time[0];
  }
  i = piece_at(run, j, a);
  if (integral == 0.0 && !LINEAR[j] && (i + 1 >= run->samples || b <= time[i + 1])) return u[i * NU];
  while (a < b) {
    double end = i + 1 < run->samples && time[i + 1] < b ? time[i + 1] : b;
    double middle = u[i * NU] + slope_on(run, j, i) * (0.5 * (a + end) - time[i]);
    integral += (end - a) * middle;
    a = end;
    i++;
  }
  return integral / length;
}

/* Value of input j at time a, from the right (side = 1) or the left (side = 0); a sample instant is met within 1e-9
   of its interval. The slope of that piece goes to *slope. */
static double input_at(Run *run, int j, double a, int side, double *slope) {
  const double *time = run->time;
  long long i;
  *slope = 0.0;
  if (a < time[0]) return run->u[j];
  i = piece_at(run, j, a);
  if (side && i + 1 < run->samples && time[i + 1] - a < 1e-9 * (time[i + 1] - time[i])) i++;
  if (!side && a - time[i] < 1e-9 * (i > 0 ? time[i] - time[i - 1] : 1.0)) {
    if (i == 0) return run->u[j];
    i--;
  }
  *slope = slope_on(run, j, i);
  return run->u[i * NU + j] + *slope * (a - time[i]);
}

static void mean_inputs(Run *run, long long k, double t, double h, int whole, double *u) {
  for (int j = 0; j < NU; j++) {
    if (DELAY[j] < 0 && !LINEAR[j])
      u[j] = run->u[k * NU + j];
    else if (DELAY[j] < 0 && whole)
      u[j] = 0.5 * (run->u[k * NU + j] + run->u[(k + 1) * NU + j]);
    else
      u[j] = input_mean(run, j, t - delay_of(run, j), t + h - delay_of(run, j));
  }
}

static void inputs_at_sample(Run *run, long long k, double *u) {
  double slope;
  for (int j = 0; j < NU; j++)
    u[j] = DELAY[j] < 0 ? run->u[k * NU + j] : input_at(run, j, run->time[k] - delay_of(run, j), 1, &slope);
}

/* ---- one interval between two samples ---- */

static long long substeps_in(const Run *run, double dt) {
  double n = ceil(dt / run->step - 1e-6);
  return n < 1.0 ? 1 : (long long)n;
}

static int not_finite(const double *v, int n) {
  double zero = 0.0;
  for (int i = 0; i < n; i++) zero += v[i] * 0.0;
  return !(zero == 0.0);
}

static int advance(Run *run, double t, double h, const double *u, double *x) {
  double next[NX + 1];
#if IMPLICIT
  const double *arg[IMPLICIT_ARG] = {&t, x, u, run->p, &h};
  double *res[IMPLICIT_RES] = {next};
  if (implicit_substep(arg, res, run->integers, run->work, 0)) return 3;
#else
  const double *arg[RK4_ARG] = {&t, x, u, run->p, &h};
  double *res[RK4_RES] = {next};
  rk4_substep(arg, res, run->integers, run->work, 0);
#endif
  if (not_finite(next, NX)) return 1;
  memcpy(x, next, NX * sizeof(double));
  return 0;
}

static int write_output(Run *run, long long k, const double *x, double *y) {
  double u[NU + 1];
  const double *arg[OUTPUT_ARG] = {run->time + k, x, u, run->p};
  double *res[OUTPUT_RES] = {y};
  inputs_at_sample(run, k, u);
  output(arg, res, run->integers, run->work, 0);
  return not_finite(y, NY) ? 2 : 0;
}

static int open_run(Run *run) {
  memset(run->cursor, 0, sizeof run->cursor);
  run->work = malloc(sizeof(double) * (WORK_REALS + 1));
  run->integers = malloc(sizeof(casadi_int) * (WORK_INTEGERS + 1));
  return run->work && run->integers ? 0 : 4;
}

static void close_run(Run *run) {
  free(run->work);
  free(run->integers);
}

/* Where a run stopped: time of the last finite state, that state. */
static int stopped(int status, double t, const double *x, double *where) {
  where[0] = t;
  memcpy(where + 1, x, NX * sizeof(double));
  return status;
}

/* ---- what runs cost: 1/2 sum (w (y - measured))^2 from sample `first` on, nothing where nothing was measured ---- */

typedef struct {
  const double *measured, *weights; /* (samples, NY), (NY); a weight of zero: not used */
  long long first;
  double cost, *gradient, *hessian; /* (NT), (NT, NT) with its upper triangle alone, once there are sensitivities */
} Sum;

/* Weighted residual of output i at sample k; 0 when it does not count. */
static int residual(const Sum *sum, long long k, int i, const double *y, double *r) {
  double measured = sum->measured[k * NY + i];
  *r = sum->weights[i] * (y[i] - measured);
  return k >= sum->first && sum->weights[i] > 0.0 && measured * 0.0 == 0.0;
}

static void add_cost(Sum *sum, long long k, const double *y) {
  double r;
  for (int i = 0; i < NY; i++)
    if (residual(sum, k, i, y, &r)) sum->cost += 0.5 * r * r;
}

/* Segment s of a recording, given by the samples where it begins, counts from and ends: its run and what it sums. */
static Run run_of(const long long *cut, const double *time, const double *u, const double *p, double step) {
  Run run = {cut[2] - cut[0], time + cut[0], u + cut[0] * NU, p, step};
  return run;
}

static Sum sum_of(const long long *cut, const double *measured, const double *weights) {
  Sum sum = {measured + cut[0] * NY, weights, cut[1] - cut[0]};
  return sum;
}

/* One run. Without sum every sample is kept: y (samples, NY), x (samples, NX); with it only the last. */
static int walk(Run *run, const double *x0, const double *restart, double *y, double *x_out, Sum *sum, double *where) {
  const double *time = run->time;
  double x[NX + 1], mean[NU + 1];
  int status = open_run(run);
  memcpy(x, x0, NX * sizeof(double));
  for (long long k = 0; k < run->samples && !status; k++) {
    long long row = sum ? 0 : k;
    memcpy(x_out + row * NX, x, NX * sizeof(double));
    if ((status = write_output(run, k, x, y + row * NY))) stopped(status, time[k], x, where);
    if (sum) add_cost(sum, k, y);
    if (k + 1 == run->samples || status) break;
    if (restart) memcpy(x, restart + k * NX, NX * sizeof(double));
    double dt = time[k + 1] - time[k];
    long long n = substeps_in(run, dt);
    for (long long i = 0; i < n && !status; i++) {
      double h = dt / (double)n, t = time[k] + (double)i * h;
      mean_inputs(run, k, t, h, n == 1, mean);
      if ((status = advance(run, t, h, mean, x))) stopped(status, t, x, where);
    }
  }
  close_run(run);
  return status;
}

/* x0 (NX); restart (samples, NX) or null: state from which each interval starts; y (samples, NY), x (samples, NX). */
EXPORT int propagate(long long samples, const double *time, const double *u, const double *p, double step,
                     const double *x0, const double *restart, double *y, double *x_out, double *where) {
  Run run = {samples, time, u, p, step};
  return walk(&run, x0, restart, y, x_out, 0, where);
}

/* cuts (segments, 3), x0 (segments, NX), cost (segments): not a number where a run stopped. */
EXPORT void propagate_costs(long long segments, const long long *cuts, const double *time, const double *u,
                            const double *p, double step, const double *x0, const double *measured,
                            const double *weights, double *cost) {
  double y[NY + 1], x[NX + 1], where[NX + 1];
  for (long long s = 0; s < segments; s++) {
    Run run = run_of(cuts + 3 * s, time, u, p, step);
    Sum sum = sum_of(cuts + 3 * s, measured, weights);
    cost[s] = walk(&run, x0 + s * NX, 0, y, x, &sum, where) ? NAN : sum.cost;
  }
}

#if NT > 0
/* ---- forward sensitivities: rows of length LD, one column per free parameter or start state; NS of the NX states
   have one, KEPT, where nothing that is measured depends on the others ---- */

/* d mean / d Td = (u(a) - u(b)) / h, one-sided towards longer dead time. */
static void mean_input_rates(Run *run, double t, double h, double *rate) {
  for (int m = 0; m < ND; m++) {
    int j = DEAD_INPUT[m];
    double a = t - delay_of(run, j), slope;
    rate[m] = (input_at(run, j, a, 0, &slope) - input_at(run, j, a + h, 0, &slope)) / h;
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

/* One stage: xdot and its derivative to theta, rows = d xdot / d theta, at (x, dx). */
static void linear_stage(Run *run, double t, const double *x, const double *u, const double *restrict dx,
                         const double *du, double *xdot, double *restrict rows) {
  double fx[FX_NNZ + 1], fp[FP_NNZ + 1], fu[FU_NNZ + 1];
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

static inline void combine(int n, double *restrict to, const double *restrict from, double factor,
                           const double *restrict rate) {
  for (int i = 0; i < n; i++) to[i] = from[i] + factor * rate[i];
}

static inline void weigh(int n, double *restrict x, double h, const double *restrict k1, const double *restrict k2,
                         const double *restrict k3, const double *restrict k4) {
  for (int i = 0; i < n; i++) x[i] = x[i] + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

static int advance_tangent(Run *run, double t, double h, const double *u, const double *du, double *x, double *dx) {
#if IMPLICIT
  double kept[NX + 1], seeds[NX * NT + 1], next[NX * NT + 1]; /* column by column, as CasADi stores matrices */
  const double *arg[TANGENT_ARG] = {&t, kept, u, run->p, &h, seeds, du};
  double *res[TANGENT_RES] = {next};
  memcpy(kept, x, NX * sizeof(double));
  for (int i = 0; i < NX; i++)
    for (int c = 0; c < NT; c++) seeds[c * NX + i] = dx[i * LD + c];
  int status = advance(run, t, h, u, x);
  if (status) return status;
  if (implicit_tangent(arg, res, run->integers, run->work, 0)) return 3;
  for (int i = 0; i < NX; i++)
    for (int c = 0; c < NT; c++) dx[i * LD + c] = next[c * NX + i];
  return not_finite(next, NX * NT) ? 3 : 0;
#else
  double k1[NX + 1], k2[NX + 1], k3[NX + 1], k4[NX + 1], xs[NX + 1];
  double d1[NS * LD + 1], d2[NS * LD + 1], d3[NS * LD + 1], d4[NS * LD + 1], ds[NS * LD + 1];
  linear_stage(run, t, x, u, dx, du, k1, d1);
  combine(NX, xs, x, h / 2, k1);
  combine(NS * LD, ds, dx, h / 2, d1);
  linear_stage(run, t + h / 2, xs, u, ds, du, k2, d2);
  combine(NX, xs, x, h / 2, k2);
  combine(NS * LD, ds, dx, h / 2, d2);
  linear_stage(run, t + h / 2, xs, u, ds, du, k3, d3);
  combine(NX, xs, x, h, k3);
  combine(NS * LD, ds, dx, h, d3);
  linear_stage(run, t + h, xs, u, ds, du, k4, d4);
  memcpy(xs, x, NX * sizeof(double));
  weigh(NX, x, h, k1, k2, k3, k4);
  weigh(NS * LD, dx, h, d1, d2, d3, d4);
  if (!not_finite(x, NX)) return 0;
  memcpy(x, xs, NX * sizeof(double));
  return 1;
#endif
}

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

/* Cost, gradient and upper triangle of the Gauss-Newton Hessian gain what sample k leaves. */
static void add_expansion(Sum *sum, long long k, const double *y, const double *dy) {
  double r, row[NT];
  for (int i = 0; i < NY; i++) {
    if (!residual(sum, k, i, y, &r)) continue;
    sum->cost += 0.5 * r * r;
    for (int c = 0; c < NT; c++) row[c] = sum->weights[i] * dy[i * NT + c];
    for (int c = 0; c < NT; c++) {
      sum->gradient[c] += r * row[c];
      for (int d = c; d < NT; d++) sum->hessian[c * NT + d] += row[c] * row[d];
    }
  }
}

/* One run with sensitivities; as `walk`. */
static int walk_tangent(Run *run, const double *x0, const double *dx0, double *y, double *dy, double *x_out,
                        double *dx_out, Sum *sum, double *where) {
  const double *time = run->time;
  double x[NX + 1], dx[NS * LD + 1], mean[NU + 1], rate[ND + 1];
  int status = open_run(run);
  FLUSH();
  memcpy(x, x0, NX * sizeof(double));
  memset(dx, 0, sizeof dx);
  for (int i = 0; i < NS; i++) memcpy(dx + i * LD, dx0 + KEPT[i] * NT, NT * sizeof(double));
  for (long long k = 0; k < run->samples && !status; k++) {
    long long row = sum ? 0 : k;
    memcpy(x_out + row * NX, x, NX * sizeof(double));
    for (int i = 0; dx_out && i < NS; i++)
      memcpy(dx_out + (row * NX + KEPT[i]) * NT, dx + i * LD, NT * sizeof(double));
    if ((status = write_linear_output(run, k, x, dx, y + row * NY, dy + row * NY * NT)))
      stopped(status, time[k], x, where);
    if (sum) add_expansion(sum, k, y, dy);
    if (k + 1 == run->samples || status) break;
    double dt = time[k + 1] - time[k];
    long long n = substeps_in(run, dt);
    for (long long i = 0; i < n && !status; i++) {
      double h = dt / (double)n, t = time[k] + (double)i * h;
      mean_inputs(run, k, t, h, n == 1, mean);
      mean_input_rates(run, t, h, rate);
      if ((status = advance_tangent(run, t, h, mean, rate, x, dx))) stopped(status, t, x, where);
    }
  }
  close_run(run);
  RESTORE();
  return status;
}

/* dx0 (NX, NT); y (samples, NY), dy (samples, NY, NT), x (samples, NX), dx (samples, NX, NT; rows KEPT) or null. */
EXPORT int propagate_tangent(long long samples, const double *time, const double *u, const double *p, double step,
                             const double *x0, const double *dx0, double *y, double *dy, double *x_out,
                             double *dx_out, double *where) {
  Run run = {samples, time, u, p, step};
  return walk_tangent(&run, x0, dx0, y, dy, x_out, dx_out, 0, where);
}

/* As `propagate_costs`; dx0 (segments, NX, NT), gradient (segments, NT), hessian (segments, NT, NT), all zero before. */
EXPORT void propagate_expansions(long long segments, const long long *cuts, const double *time, const double *u,
                                 const double *p, double step, const double *x0, const double *dx0,
                                 const double *measured, const double *weights, double *cost, double *gradient,
                                 double *hessian) {
  double y[NY + 1], dy[NY * NT + 1], x[NX + 1], where[NX + 1];
  for (long long s = 0; s < segments; s++) {
    Run run = run_of(cuts + 3 * s, time, u, p, step);
    Sum sum = sum_of(cuts + 3 * s, measured, weights);
    double *H = sum.hessian = hessian + s * NT * NT;
    sum.gradient = gradient + s * NT;
    cost[s] = walk_tangent(&run, x0 + s * NX, dx0 + s * NX * NT, y, dy, x, 0, &sum, where) ? NAN : sum.cost;
    for (int c = 0; c < NT; c++)
      for (int d = 0; d < c; d++) H[c * NT + d] = H[d * NT + c];
  }
}
#endif
