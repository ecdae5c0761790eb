/* Walks the samples of one recording through one model.

   Generated in front of this text: the sizes (NX states, NS of them with sensitivities, NU inputs, NP parameters, NY
   outputs, NT sensitivities, LD = NT rounded up), the sparse products of the sensitivities as macros, and the CasADi functions

     rk4_substep  (t, x, u, p, h) -> x, roughness               (explicit steps only)
     output       (t, x, u, p) -> y
     linear_rate  (t, x, u, p) -> x', df/dx, df/dp, df/du      (nonzeros only)
     linear_output(t, x, u, p) -> y , dh/dx, dh/dp, dh/du

   Status: 0 done; 1 a state, 2 an output left the finite numbers; 3 the implicit method gave up; 4 out of memory;
   5 explicit steps have become dearer than implicit ones. */

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

/* As in control.py. */
typedef struct {
  double step, tolerance, trials;
} Control;

typedef struct {
  long long samples;
  const double *time, *u, *p;
  Control control;
  double reached;   /* time of the last finite state */
  double ahead;     /* length of the next implicit step; 0: not known yet */
  double trials[2]; /* left for steps where one was rough: for states, for their sensitivities */
  double unit[NX + 1]; /* of an error in each state; infinite where no output sees it */
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

static double mean_input(Run *run, long long k, int j, double t, double h, int whole) {
  if (DELAY[j] < 0 && !LINEAR[j]) return run->u[k * NU + j];
  if (DELAY[j] < 0 && whole) return 0.5 * (run->u[k * NU + j] + run->u[(k + 1) * NU + j]);
  double slope, a = t - delay_of(run, j), b = t + h - delay_of(run, j);
  return b > a ? input_mean(run, j, a, b) : input_at(run, j, a, 1, &slope);
}

static void mean_inputs(Run *run, long long k, double t, double h, int whole, double *u) {
  for (int j = 0; j < NU; j++) u[j] = mean_input(run, k, j, t, h, whole);
}

/* Inputs just behind time t of interval k, and their slopes there. */
static void inputs_behind(Run *run, long long k, double t, double *u, double *slope) {
  for (int j = 0; j < NU; j++) {
    if (DELAY[j] >= 0) {
      u[j] = input_at(run, j, t - delay_of(run, j), 1, slope + j);
      continue;
    }
    slope[j] = slope_on(run, j, k);
    u[j] = run->u[k * NU + j] + slope[j] * (t - run->time[k]);
  }
}

/* Where a step from t ends: at `end`, or before, where a late input that is held jumps. What follows from the mean of two
   values is not the mean of what follows from each. Implicit steps, which may be long, end at kinks, too. */
static double end_of_piece(Run *run, double t, double end) {
  const double *time = run->time;
  for (int j = 0; CUT && j < NU; j++) {
    double late = delay_of(run, j);
    if (DELAY[j] < 0 || (LINEAR[j] && !IMPLICIT)) continue;
    for (long long i = t - late < time[0] ? 0 : piece_at(run, j, t - late) + 1; i < run->samples; i++) {
      double at = time[i] + late, near = 1e-9 * (i ? time[i] - time[i - 1] : time[1] - time[0]);
      if (at > end - near) break;
      if (at < t + near || (!LINEAR[j] && (!i || run->u[i * NU + j] == run->u[(i - 1) * NU + j]))) continue;
      end = at;
      break;
    }
  }
  return end;
}

static void inputs_at_sample(Run *run, long long k, double *u) {
  double slope;
  for (int j = 0; j < NU; j++)
    u[j] = DELAY[j] < 0 ? run->u[k * NU + j] : input_at(run, j, run->time[k] - delay_of(run, j), 1, &slope);
}

/* ---- one interval between two samples ---- */

/* Implicit steps find their own lengths. */
static long long substeps_in(const Run *run, double dt) {
  double n = IMPLICIT ? 1.0 : ceil(dt / run->control.step - 1e-6);
  return n < 1.0 ? 1 : (long long)n;
}

static int not_finite(const double *v, int n) {
  double zero = 0.0;
  for (int i = 0; i < n; i++) zero += v[i] * 0.0;
  return !(zero == 0.0);
}

/* A step [t, t + h] inside interval k, from z to next: NX states, behind them the sensitivities where there are any.
   ROUGH: it is to be refined; else a status. */
typedef int Step(Run *run, long long k, double t, double h, int whole, const double *z, double *next);
#define ROUGH (-1)
#define DEAR 5

#if IMPLICIT /* in implicit.c */
static Step step_state;
static int refine(Run *run, Step *step, int size, long long k, double t, double h, double *z, int judged);
#else
static int judged(const Run *run, const double *x, const double *next, const double *roughness) {
  double ratio[NX + 1], sum = 0.0, smooth = SMOOTH * run->control.tolerance;
  for (int i = 0; i < NX; i++) {
    double unit = run->unit[i] + fabs(x[i]);
    ratio[i] = roughness[i] / (unit * unit);
  }
  for (int i = 0; i < NX; i++) sum += ratio[i];
  if (sum < smooth * smooth) return 0; /* not so for nan */
  return smooth < INFINITY ? ROUGH : not_finite(next, NX);
}

static int step_state(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  double mean[NU + 1], roughness[NX + 1];
  const double *arg[RK4_ARG] = {&t, z, mean, run->p, &h};
  double *res[RK4_RES] = {next, roughness};
  mean_inputs(run, k, t, h, whole, mean);
  rk4_substep(arg, res, run->integers, run->work, 0);
  return judged(run, z, next, roughness);
}

/* Whether a whole step and its two halves are within the tolerance of each other, sensitivities in units of the state
   by the free value among them. */
static int agree(const Run *run, const double *whole, const double *halves, int size) {
  double sum = 0.0, tolerance = run->control.tolerance;
  for (int i = 0; i < NX; i++) {
    double apart = (whole[i] - halves[i]) / (run->unit[i] + fabs(halves[i]));
    sum += apart * apart;
  }
  for (int i = 0; size > NX && i < NS; i++)
    for (int c = 0; c < NT; c++) {
      double unit = NOMINAL_FREE[c] + (FREE[c] < 0 ? 0.0 : fabs(run->p[FREE[c]]));
      const double *w = whole + NX + i * LD + c, *d = halves + NX + i * LD + c;
      double apart = (*w - *d) * unit / (NOMINAL[KEPT[i]] + fabs(*d) * unit);
      sum += apart * apart;
    }
  return sum <= tolerance * tolerance;
}

/* A rough step in parts of h / 2^level, each as long as the first `judged` of what moves agree with two halves. States
   alone decide on their steps, so that a cost and its gradient have the same; inside one, sensitivities may take more. */
static int refine(Run *run, Step *step, int size, long long k, double t, double h, double *z, int judged) {
  double whole[MOVING + 1], middle[MOVING + 1], halves[MOVING + 1];
  long long all = 1LL << DEEPEST, done = 0, part = all;
  while (done < all) {
    double half = 0.5 * h * ((double)part / (double)all), from = t + h * ((double)done / (double)all);
    if (judged == NX) run->reached = from;
    if ((run->trials[judged > NX] -= 3) < 0) return DEAR;
    step(run, k, from, 2 * half, 0, z, whole);
    step(run, k, from, half, 0, z, middle);
    step(run, k, from + half, half, 0, middle, halves);
    if (part > 1 && !agree(run, whole, halves, judged)) {
      part /= 2;
      continue;
    }
    if (not_finite(halves, NX)) return 1;
    if (size > judged && !agree(run, whole, halves, size)) {
      int status = refine(run, step, size, k, from, 2 * half, z, size);
      if (status) return status;
      memcpy(z, halves, NX * sizeof(double));
    } else
      memcpy(z, halves, size * sizeof(double));
    done += part;
    if (part < all && done % (2 * part) == 0) part *= 2;
  }
  return 0;
}
#endif

/* What a longer dead time changes where its inputs jump; in sensitivities.c. */
#if ND > 0
static void derive_jumps(Run *run, long long k, double t, const double *x, double *dx);
#endif

/* The substeps of interval k, each in pieces without a jump. On a stop run->reached and z are the last that is finite. */
static inline int cross(Run *run, Step *step, int size, long long k, double *z) {
  double next[MOVING + 1], dt = run->time[k + 1] - run->time[k];
  long long n = substeps_in(run, dt);
  int status = 0;
  for (long long i = 0; i < n; i++) {
    double all = dt / (double)n, start = run->time[k] + (double)i * all, end = start + all;
    for (double t = start, until; t < end && !status; t = until) {
      until = end_of_piece(run, t, end);
      int cut = t > start || until < end;
      double h = cut ? until - t : all;
      run->reached = t;
#if ND > 0
      if (size > NX) derive_jumps(run, k, t, z, z + NX);
#endif
      status = step(run, k, t, h, n == 1 && !cut, z, next);
      if (status == ROUGH)
        status = refine(run, step, size, k, t, h, z, NX);
      else if (!status || IMPLICIT)
        memcpy(z, next, size * sizeof(double));
    }
    if (status) return status;
  }
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

/* Where the parameters in ZERO are 0, states that are not KEPT reach no output: nobody waits for their errors. */
static void units_of_errors(Run *run) {
  int still = 1;
  for (int m = 0; m < NZ; m++) still = still && run->p[ZERO[m]] == 0.0;
  for (int i = 0; i < NX; i++) run->unit[i] = still ? INFINITY : NOMINAL[i];
  for (int i = 0; i < NS; i++) run->unit[KEPT[i]] = NOMINAL[KEPT[i]];
}

static int open_run(Run *run) {
  double span = run->time[run->samples - 1] - run->time[0], plain = span / run->control.step + (double)run->samples;
  run->trials[0] = run->trials[1] = BURST + run->control.trials * plain;
#if IMPLICIT
  run->trials[0] = IMPLICIT_BURST + IMPLICIT_STEPS * (double)run->samples;
  run->control.tolerance = IMPLICIT_SHARE * (run->control.tolerance < INFINITY ? run->control.tolerance : TOLERANCE);
#endif
  memset(run->cursor, 0, sizeof run->cursor);
  units_of_errors(run);
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
  const double *limit;              /* of the cost, or of each output's squares: a run beyond it stops; or null */
  long long first;
  int beyond;
  double cost;
  double *squares, *gradient, *hessian; /* by output, without weights: (NY), (NY, NT), (NY, NT, NT): upper triangles */
} Sum;

/* Residual of output i at sample k; 0 when nothing was measured. */
static int residual(const Sum *sum, long long k, int i, const double *y, double *r) {
  double measured = sum->measured[k * NY + i];
  *r = y[i] - measured;
  return k >= sum->first && measured * 0.0 == 0.0;
}

static void add_cost(Sum *sum, long long k, const double *y) {
  double r;
  for (int i = 0; i < NY; i++)
    if (sum->weights[i] > 0.0 && residual(sum, k, i, y, &r)) {
      r *= sum->weights[i];
      sum->cost += 0.5 * r * r;
    }
  sum->beyond = sum->limit && sum->cost > *sum->limit;
}

/* Segment s of a recording, given by the samples where it begins, counts from and ends: its run and what it sums. */
static Run run_of(const long long *cut, const double *time, const double *u, const double *p, Control control) {
  Run run = {cut[2] - cut[0], time + cut[0], u + cut[0] * NU, p, control};
  return run;
}

static Sum sum_of(const long long *cut, const double *measured, const double *weights, const double *limit) {
  Sum sum = {measured + cut[0] * NY, weights, limit, cut[1] - cut[0]};
  return sum;
}

/* One run. Without sum every sample is kept: y (samples, NY), x (samples, NX); with it only the last. */
static int walk(Run *run, const double *x0, const double *restart, double *y, double *x_out, Sum *sum, double *where) {
  const double *time = run->time;
  double x[NX + 1];
  int status = open_run(run);
  memcpy(x, x0, NX * sizeof(double));
  for (long long k = 0; k < run->samples && !status; k++) {
    long long row = sum ? 0 : k;
    memcpy(x_out + row * NX, x, NX * sizeof(double));
    if ((status = write_output(run, k, x, y + row * NY))) stopped(status, time[k], x, where);
    if (sum) add_cost(sum, k, y);
    if (sum && sum->beyond) status = 1;
    if (k + 1 == run->samples || status) break;
    if (restart) memcpy(x, restart + k * NX, NX * sizeof(double));
    if ((status = cross(run, step_state, NX, k, x))) stopped(status, run->reached, x, where);
  }
  close_run(run);
  return status;
}

/* x0 (NX); restart (samples, NX) or null: state from which each interval starts; y (samples, NY), x (samples, NX). */
EXPORT int propagate(long long samples, const double *time, const double *u, const double *p, Control control,
                     const double *x0, const double *restart, double *y, double *x_out, double *where) {
  Run run = {samples, time, u, p, control};
  return walk(&run, x0, restart, y, x_out, 0, where);
}

/* cuts (segments, 3), x0 (segments, NX), limits (segments) or null, cost (segments): not a number where a run stopped or
   passed its limit, infinite where it became dear. */
EXPORT void propagate_costs(long long segments, const long long *cuts, const double *time, const double *u,
                            const double *p, Control control, const double *x0, const double *measured,
                            const double *weights, const double *limits, double *cost) {
  double y[NY + 1], x[NX + 1], where[NX + 1];
  for (long long s = 0; s < segments; s++) {
    Run run = run_of(cuts + 3 * s, time, u, p, control);
    Sum sum = sum_of(cuts + 3 * s, measured, weights, limits ? limits + s : 0);
    int status = walk(&run, x0 + s * NX, 0, y, x, &sum, where);
    cost[s] = status == DEAR ? INFINITY : status || sum.cost == INFINITY ? NAN : sum.cost;
  }
}
