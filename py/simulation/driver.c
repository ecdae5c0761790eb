/* Walks the samples of one recording through one model, which it is told as data: compiled once for all of them.

   In front of this text stand the constants of control.py and model.h.

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
  const Model *model;
  long long samples;
  const double *time, *u, *p;
  Control control;
  double reached;   /* time of the last finite state */
  double ahead;     /* length of the next implicit step; 0: not known yet */
  double trials[2]; /* left for steps where one was rough: for states, for their sensitivities */
  double *unit;     /* of an error in each state; infinite where no output sees it */
  Integer *cursor;  /* of each input: the piece that was read last */
  const double **arg; /* of the model's functions: arguments, results, work */
  double **res, *work;
  Integer *integers;
} Run;

/* States, behind them the rows of their sensitivities. */
static inline int moving(const Model *m) { return m->nx + m->ns * m->ld; }

static inline void call(Run *run, Function *function, const double *t, const double *x, const double *u) {
  run->arg[0] = t, run->arg[1] = x, run->arg[2] = u, run->arg[3] = run->p;
  function(run->arg, run->res, run->integers, run->work, 0);
}

/* ---- inputs: held or linear between samples, delayed by a parameter, first value before the first sample ---- */

static double delay_of(const Run *run, int j) {
  int delay = run->model->delay[j];
  return delay < 0 ? 0.0 : run->p[delay];
}

/* Index i of the piece [t_i, t_{i+1}) that holds time a; the cursor remembers it for the next call. */
static long long piece_at(Run *run, int j, double a) {
  long long i = run->cursor[j];
  while (i > 0 && run->time[i] > a) i--;
  while (i + 1 < run->samples && run->time[i + 1] <= a) i++;
  return run->cursor[j] = i;
}

static double slope_on(const Run *run, int j, long long i) {
  const Model *m = run->model;
  if (!m->linear[j] || i + 1 >= run->samples) return 0.0;
  return (run->u[(i + 1) * m->nu + j] - run->u[i * m->nu + j]) / (run->time[i + 1] - run->time[i]);
}

/* Mean of input j over [a, b]: exact for held and for linear inputs. */
static double input_mean(Run *run, int j, double a, double b) {
  const Model *m = run->model;
  const double *time = run->time, *u = run->u + j;
  double integral = 0.0, length = b - a;
  long long i;
  if (b <= time[0]) return u[0];
  if (a < time[0]) {
    integral = (time[0] - a) * u[0];
    a = time[0];
  }
  i = piece_at(run, j, a);
  if (integral == 0.0 && !m->linear[j] && (i + 1 >= run->samples || b <= time[i + 1])) return u[i * m->nu];
  while (a < b) {
    double end = i + 1 < run->samples && time[i + 1] < b ? time[i + 1] : b;
    double middle = u[i * m->nu] + slope_on(run, j, i) * (0.5 * (a + end) - time[i]);
    integral += (end - a) * middle;
    a = end;
    i++;
  }
  return integral / length;
}

/* Value of input j at time a, from the right (side = 1) or the left (side = 0); a sample instant is met within 1e-9
   of its interval. The slope of that piece goes to *slope. */
static double input_at(Run *run, int j, double a, int side, double *slope) {
  const Model *m = run->model;
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
  return run->u[i * m->nu + j] + *slope * (a - time[i]);
}

static double mean_input(Run *run, long long k, int j, double t, double h, int whole) {
  const Model *m = run->model;
  if (m->delay[j] < 0 && !m->linear[j]) return run->u[k * m->nu + j];
  if (m->delay[j] < 0 && whole) return 0.5 * (run->u[k * m->nu + j] + run->u[(k + 1) * m->nu + j]);
  double slope, a = t - delay_of(run, j), b = t + h - delay_of(run, j);
  return b > a ? input_mean(run, j, a, b) : input_at(run, j, a, 1, &slope);
}

static void mean_inputs(Run *run, long long k, double t, double h, int whole, double *u) {
  for (int j = 0; j < run->model->nu; j++) u[j] = mean_input(run, k, j, t, h, whole);
}

/* Inputs just behind time t of interval k, and their slopes there. */
static void inputs_behind(Run *run, long long k, double t, double *u, double *slope) {
  const Model *m = run->model;
  for (int j = 0; j < m->nu; j++) {
    if (m->delay[j] >= 0) {
      u[j] = input_at(run, j, t - delay_of(run, j), 1, slope + j);
      continue;
    }
    slope[j] = slope_on(run, j, k);
    u[j] = run->u[k * m->nu + j] + slope[j] * (t - run->time[k]);
  }
}

/* Where a step from t ends: at `end`, or before, where a late input that is held jumps. What follows from the mean of two
   values is not the mean of what follows from each. Implicit steps, which may be long, end at kinks, too. */
static double end_of_piece(Run *run, double t, double end) {
  const Model *m = run->model;
  const double *time = run->time;
  for (int j = 0; m->cut && j < m->nu; j++) {
    double late = delay_of(run, j);
    if (m->delay[j] < 0 || (m->linear[j] && !m->implicit)) continue;
    for (long long i = t - late < time[0] ? 0 : piece_at(run, j, t - late) + 1; i < run->samples; i++) {
      double at = time[i] + late, near = 1e-9 * (i ? time[i] - time[i - 1] : time[1] - time[0]);
      if (at > end - near) break;
      if (at < t + near || (!m->linear[j] && (!i || run->u[i * m->nu + j] == run->u[(i - 1) * m->nu + j]))) continue;
      end = at;
      break;
    }
  }
  return end;
}

static void inputs_at_sample(Run *run, long long k, double *u) {
  const Model *m = run->model;
  double slope;
  for (int j = 0; j < m->nu; j++)
    u[j] = m->delay[j] < 0 ? run->u[k * m->nu + j] : input_at(run, j, run->time[k] - delay_of(run, j), 1, &slope);
}

/* ---- one interval between two samples ---- */

/* Implicit steps find their own lengths. */
static long long substeps_in(const Run *run, double dt) {
  double n = run->model->implicit ? 1.0 : ceil(dt / run->control.step - 1e-6);
  return n < 1.0 ? 1 : (long long)n;
}

static int not_finite(const double *v, int n) {
  double zero = 0.0;
  for (int i = 0; i < n; i++) zero += v[i] * 0.0;
  return !(zero == 0.0);
}

/* A step [t, t + h] inside interval k, from z to next: nx states, behind them the sensitivities where there are any.
   ROUGH: it is to be refined; else a status. */
typedef int Step(Run *run, long long k, double t, double h, int whole, const double *z, double *next);
#define ROUGH (-1)
#define DEAR 5

static Step explicit_state; /* in explicit.c */
static Step implicit_state; /* in implicit.c */

static int judged(const Run *run, const double *x, const double *next, const double *roughness) {
  const Model *m = run->model;
  double ratio[m->nx + 1], sum = 0.0, smooth = SMOOTH * run->control.tolerance;
  for (int i = 0; i < m->nx; i++) {
    double unit = run->unit[i] + fabs(x[i]);
    ratio[i] = roughness[i] / (unit * unit);
  }
  for (int i = 0; i < m->nx; i++) sum += ratio[i];
  if (sum < smooth * smooth) return 0; /* not so for nan */
  return smooth < INFINITY ? ROUGH : not_finite(next, m->nx);
}

/* Whether a whole step and its two halves are within the tolerance of each other, sensitivities in units of the state
   by the free value among them. */
static int agree(const Run *run, const double *whole, const double *halves, int size) {
  const Model *m = run->model;
  double sum = 0.0, tolerance = run->control.tolerance;
  for (int i = 0; i < m->nx; i++) {
    double apart = (whole[i] - halves[i]) / (run->unit[i] + fabs(halves[i]));
    sum += apart * apart;
  }
  for (int i = 0; size > m->nx && i < m->ns; i++)
    for (int c = 0; c < m->nt; c++) {
      double unit = m->nominal_free[c] + (m->free[c] < 0 ? 0.0 : fabs(run->p[m->free[c]]));
      const double *w = whole + m->nx + i * m->ld + c, *d = halves + m->nx + i * m->ld + c;
      double apart = (*w - *d) * unit / (m->nominal[m->kept[i]] + fabs(*d) * unit);
      sum += apart * apart;
    }
  return sum <= tolerance * tolerance;
}

/* A rough step in parts of h / 2^level, each as long as the first `judged` of what moves agree with two halves. States
   alone decide on their steps, so that a cost and its gradient have the same; inside one, sensitivities may take more. */
static int refine(Run *run, Step *step, int size, long long k, double t, double h, double *z, int judged) {
  const Model *m = run->model;
  double whole[moving(m) + 1], middle[moving(m) + 1], halves[moving(m) + 1];
  long long all = 1LL << DEEPEST, done = 0, part = all;
  while (done < all) {
    double half = 0.5 * h * ((double)part / (double)all), from = t + h * ((double)done / (double)all);
    if (judged == m->nx) run->reached = from;
    if ((run->trials[judged > m->nx] -= 3) < 0) return DEAR;
    step(run, k, from, 2 * half, 0, z, whole);
    step(run, k, from, half, 0, z, middle);
    step(run, k, from + half, half, 0, middle, halves);
    if (part > 1 && !agree(run, whole, halves, judged)) {
      part /= 2;
      continue;
    }
    if (not_finite(halves, m->nx)) return 1;
    if (size > judged && !agree(run, whole, halves, size)) {
      int status = refine(run, step, size, k, from, 2 * half, z, size);
      if (status) return status;
      memcpy(z, halves, m->nx * sizeof(double));
    } else
      memcpy(z, halves, size * sizeof(double));
    done += part;
    if (part < all && done % (2 * part) == 0) part *= 2;
  }
  return 0;
}

/* What a longer dead time changes where its inputs jump; in sensitivities.c. */
static void derive_jumps(Run *run, long long k, double t, const double *x, double *dx);

/* The substeps of interval k, each in pieces without a jump. On a stop run->reached and z are the last that is finite. */
static inline int cross(Run *run, Step *step, int size, long long k, double *z) {
  const Model *m = run->model;
  double next[moving(m) + 1], dt = run->time[k + 1] - run->time[k];
  long long n = substeps_in(run, dt);
  int status = 0;
  for (long long i = 0; i < n; i++) {
    double all = dt / (double)n, start = run->time[k] + (double)i * all, end = start + all;
    for (double t = start, until; t < end && !status; t = until) {
      until = end_of_piece(run, t, end);
      int cut = t > start || until < end;
      double h = cut ? until - t : all;
      run->reached = t;
      if (m->nd > 0 && size > m->nx) derive_jumps(run, k, t, z, z + m->nx);
      status = step(run, k, t, h, n == 1 && !cut, z, next);
      if (status == ROUGH)
        status = refine(run, step, size, k, t, h, z, m->nx);
      else if (!status || m->implicit)
        memcpy(z, next, size * sizeof(double));
    }
    if (status) return status;
  }
  return 0;
}

static int write_output(Run *run, long long k, const double *x, double *y) {
  const Model *m = run->model;
  double u[m->nu + 1];
  inputs_at_sample(run, k, u);
  run->res[0] = y;
  call(run, m->output, run->time + k, x, u);
  return not_finite(y, m->ny) ? 2 : 0;
}

/* Where the parameters at zero are 0, states that are not kept reach no output: nobody waits for their errors. */
static void units_of_errors(Run *run) {
  const Model *m = run->model;
  int still = 1;
  for (int n = 0; n < m->nz; n++) still = still && run->p[m->zero[n]] == 0.0;
  for (int i = 0; i < m->nx; i++) run->unit[i] = still ? INFINITY : m->nominal[i];
  for (int i = 0; i < m->ns; i++) run->unit[m->kept[i]] = m->nominal[m->kept[i]];
}

static int open_run(Run *run) {
  const Model *m = run->model;
  double span = run->time[run->samples - 1] - run->time[0], plain = span / run->control.step + (double)run->samples;
  run->trials[0] = run->trials[1] = BURST + run->control.trials * plain;
  if (m->implicit) {
    double tolerance = run->control.tolerance;
    run->trials[0] = IMPLICIT_BURST + IMPLICIT_STEPS * (double)run->samples;
    run->control.tolerance = IMPLICIT_SHARE * (tolerance < INFINITY ? tolerance : TOLERANCE);
  }
  run->unit = malloc(sizeof(double) * (m->nx + m->reals + 1));
  run->cursor = calloc(m->nu + m->integers + 1, sizeof(Integer));
  run->arg = malloc(sizeof(double *) * (m->arguments + m->results));
  if (!run->unit || !run->cursor || !run->arg) return 4;
  run->work = run->unit + m->nx;
  run->integers = run->cursor + m->nu;
  run->res = (double **)run->arg + m->arguments;
  units_of_errors(run);
  return 0;
}

static void close_run(Run *run) {
  free(run->unit);
  free(run->cursor);
  free(run->arg);
}

/* Where a run stopped: time of the last finite state, that state. */
static int stopped(const Run *run, int status, double t, const double *x, double *where) {
  where[0] = t;
  memcpy(where + 1, x, run->model->nx * sizeof(double));
  return status;
}

/* ---- what runs cost: 1/2 sum (w (y - measured))^2 from sample `first` on, nothing where nothing was measured ---- */

typedef struct {
  const double *measured, *weights; /* (samples, ny), (ny); a weight of zero: not used */
  const double *limit;              /* of the cost, or of each output's squares: a run beyond it stops; or null */
  long long first;
  int outputs, beyond;
  double cost;
  double *squares, *gradient, *hessian; /* by output, without weights: (ny), (ny, nt), (ny, nt, nt): upper triangles */
} Sum;

/* Residual of output i at sample k; 0 when nothing was measured. */
static int residual(const Sum *sum, long long k, int i, const double *y, double *r) {
  double measured = sum->measured[k * sum->outputs + i];
  *r = y[i] - measured;
  return k >= sum->first && measured * 0.0 == 0.0;
}

static void add_cost(Sum *sum, long long k, const double *y) {
  double r;
  for (int i = 0; i < sum->outputs; i++)
    if (sum->weights[i] > 0.0 && residual(sum, k, i, y, &r)) {
      r *= sum->weights[i];
      sum->cost += 0.5 * r * r;
    }
  sum->beyond = sum->limit && sum->cost > *sum->limit;
}

/* A model over a recording: time (samples), u (samples, nu), p (np). */
typedef struct {
  const Model *model;
  const double *time, *u, *p;
  Control control;
} Task;

/* Segment s of a recording, given by the samples where it begins, counts from and ends: its run and what it sums. */
static Run run_of(const Task *task, const long long *cut) {
  const Model *m = task->model;
  Run run = {m, cut[2] - cut[0], task->time + cut[0], task->u + cut[0] * m->nu, task->p, task->control};
  return run;
}

static Sum sum_of(const Task *task, const long long *cut, const double *measured, const double *limit) {
  int outputs = task->model->ny;
  Sum sum = {measured + cut[0] * outputs, 0, limit, cut[1] - cut[0], outputs};
  return sum;
}

/* One run. Without sum every sample is kept: y (samples, ny), x (samples, nx); with it only the last. */
static int walk(Run *run, const double *x0, const double *restart, double *y, double *x_out, Sum *sum, double *where) {
  const Model *m = run->model;
  const double *time = run->time;
  double x[m->nx + 1];
  Step *step = m->implicit ? implicit_state : explicit_state;
  int status = open_run(run);
  memcpy(x, x0, m->nx * sizeof(double));
  for (long long k = 0; k < run->samples && !status; k++) {
    long long row = sum ? 0 : k;
    memcpy(x_out + row * m->nx, x, m->nx * sizeof(double));
    if ((status = write_output(run, k, x, y + row * m->ny))) stopped(run, status, time[k], x, where);
    if (sum) add_cost(sum, k, y);
    if (sum && sum->beyond) status = 1;
    if (k + 1 == run->samples || status) break;
    if (restart) memcpy(x, restart + k * m->nx, m->nx * sizeof(double));
    if ((status = cross(run, step, m->nx, k, x))) stopped(run, status, run->reached, x, where);
  }
  close_run(run);
  return status;
}

/* x0 (nx); restart (samples, nx) or null: state from which each interval starts; y (samples, ny), x (samples, nx). */
EXPORT int propagate(const Task *task, long long samples, const double *x0, const double *restart, double *y,
                     double *x_out, double *where) {
  long long cut[3] = {0, 0, samples};
  Run run = run_of(task, cut);
  return walk(&run, x0, restart, y, x_out, 0, where);
}

/* cuts (segments, 3), x0 (segments, nx), limits (segments) or null, cost (segments): not a number where a run stopped or
   passed its limit, infinite where it became dear. */
EXPORT void propagate_costs(const Task *task, long long segments, const long long *cuts, const double *x0,
                            const double *measured, const double *weights, const double *limits, double *cost) {
  const Model *m = task->model;
  double y[m->ny + 1], x[m->nx + 1], where[m->nx + 1];
  for (long long s = 0; s < segments; s++) {
    Run run = run_of(task, cuts + 3 * s);
    Sum sum = sum_of(task, cuts + 3 * s, measured, limits ? limits + s : 0);
    sum.weights = weights;
    int status = walk(&run, x0 + s * m->nx, 0, y, x, &sum, where);
    cost[s] = status == DEAR ? INFINITY : status || sum.cost == INFINITY ? NAN : sum.cost;
  }
}
