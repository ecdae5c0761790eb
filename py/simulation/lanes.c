/* Walks LANES sets of parameters through one recording side by side. Stands behind driver.c and vectors.c.

   Every lane is the run that it would be alone: it has its dead times, refines its own rough steps and stops by itself.
   A lane that stopped, or never had a set, follows one that runs, so that nobody waits for its infinite numbers. */

/* What a library of lanes has beside its model. */
typedef struct {
  void (*rk4_substep)(const Lanes *t, const Lanes *x, const Lanes *u, const Lanes *p, const Lanes *h, Lanes *next,
                      Lanes *roughness);
  void (*output)(const Lanes *t, const Lanes *x, const Lanes *u, const Lanes *p, Lanes *y);
} SideBySide;

typedef struct {
  const Model *model;
  const SideBySide *functions;
  Run run[LANES];
  Lanes *x, *p, *squares;
  long long running[LANES]; /* -1 or 0 */
  int lead;                /* the first lane that runs */
  const double *measured;  /* (samples, ny) */
  double *y, *x_out;       /* (lanes, samples, ny), (lanes, samples, nx) or null */
  double *left, *where;    /* squares (lanes, ny) or null, (lanes, nx + 1) */
  int *status;
} Walk;

static void take_lane(const Walk *walk, const Lanes *z, int lane, double *x) {
  for (int i = 0; i < walk->model->nx; i++) x[i] = LANE(z[i], lane);
}

/* Lanes that do not run follow the first that does; 0 when none is left. */
static int follow(Walk *walk) {
  const Model *m = walk->model;
  for (walk->lead = 0; walk->lead < LANES && !walk->running[walk->lead];) walk->lead++;
  for (int l = 0; walk->lead < LANES && l < LANES; l++) {
    if (walk->running[l]) continue;
    for (int i = 0; i < m->nx; i++) LANE(walk->x[i], l) = LANE(walk->x[i], walk->lead);
    for (int i = 0; i < m->np; i++) LANE(walk->p[i], l) = LANE(walk->p[i], walk->lead);
  }
  return walk->lead < LANES;
}

static void stop_lane(Walk *walk, int lane, int status, double t, const double *x) {
  walk->status[lane] = stopped(walk->run + lane, status, t, x, walk->where + lane * (walk->model->nx + 1));
  walk->running[lane] = 0;
}

/* ---- inputs: those without a dead time are the same for all ---- */

/* Over the piece of each lane; one whose substep has ended keeps what it had. */
static void mean_inputs_of_lanes(Walk *walk, long long k, const Lanes *t, const Lanes *h, int whole, int first, Lanes *u) {
  const Model *m = walk->model;
  for (int j = 0; j < m->nu; j++) {
    int same = m->delay[j] < 0 && !(m->cut && m->linear[j]), lead = walk->lead;
    if (first) u[j] = in_all(mean_input(walk->run + lead, k, j, LANE(*t, lead), LANE(*h, lead), whole));
    for (int l = first ? lead + 1 : 0; !same && l < LANES; l++)
      if (walk->running[l] && LANE(*h, l) > 0.0)
        LANE(u[j], l) = mean_input(walk->run + l, k, j, LANE(*t, l), LANE(*h, l), whole);
  }
}

static void inputs_of_lanes_at_sample(Walk *walk, long long k, Lanes *u) {
  const Model *m = walk->model;
  double seen[m->nu + 1], slope;
  inputs_at_sample(walk->run + walk->lead, k, seen);
  for (int j = 0; j < m->nu; j++) {
    u[j] = in_all(seen[j]);
    for (int l = walk->lead + 1; m->delay[j] >= 0 && l < LANES; l++) {
      Run *run = walk->run + l;
      if (walk->running[l]) LANE(u[j], l) = input_at(run, j, run->time[k] - delay_of(run, j), 1, &slope);
    }
  }
}

/* ---- one interval between two samples ---- */

/* As `judged`: the lanes that run and are not smooth, by their marks (LANES); 0 when there are none. */
static int rough_lanes(const Walk *walk, const Lanes *roughness, long long *rough) {
  const Run *run = walk->run;
  double smooth = SMOOTH * run->control.tolerance;
  long long found = 0;
  for (int half = 0; half < 2; half++) {
    Vector sum = spread(0.0);
    for (int i = 0; i < walk->model->nx; i++) {
      Vector unit = run->unit[i] + vector_fabs(walk->x[i].half[half]);
      sum += roughness[i].half[half] / (unit * unit);
    }
    Mask open = ~(sum < smooth * smooth);
    memcpy(rough + half * WIDTH, &open, sizeof open);
  }
  for (int l = 0; l < LANES; l++) found |= rough[l] &= walk->running[l];
  return found != 0;
}

/* A lane whose step is not smooth: refined, accepted as it is, or stopped. */
static void settle(Walk *walk, int lane, long long k, double t, double h, Lanes *next) {
  const Model *m = walk->model;
  Run *run = walk->run + lane;
  double x[m->nx + 1], end[m->nx + 1];
  int status;
  take_lane(walk, walk->x, lane, x);
  run->reached = t;
  if (SMOOTH * run->control.tolerance < INFINITY) {
    status = refine(run, explicit_state, m->nx, k, t, h, x, m->nx);
    for (int i = 0; i < m->nx; i++) LANE(next[i], lane) = x[i];
  } else {
    take_lane(walk, next, lane, end);
    status = not_finite(end, m->nx);
  }
  if (status) stop_lane(walk, lane, status, run->reached, x);
}

/* The next piece without a jump of every lane, from t on: where it ends, and how long it is, 0 where the substep has
   ended. Whether all are whole substeps. */
static int pieces_of_lanes(Walk *walk, const Lanes *t, double end, double all, int first, Lanes *until, Lanes *h) {
  int whole = first;
  *until = in_all(end);
  for (int l = 0; walk->model->cut && l < LANES; l++) {
    double from = LANE(*t, l);
    if (from < end && walk->running[l]) LANE(*until, l) = end_of_piece(walk->run + l, from, end);
    int cut = !first || LANE(*until, l) < end;
    LANE(*h, l) = cut ? LANE(*until, l) - from : all;
    whole = whole && !cut;
  }
  return whole;
}

/* One substep from `start` on; 0 when no lane is left. */
static int substep_of_lanes(Walk *walk, long long k, double start, double all, int alone) {
  const Model *m = walk->model;
  Lanes u[m->nu + 1], next[m->nx + 1], roughness[m->nx + 1], t = in_all(start), h = in_all(all), until;
  long long rough[LANES];
  int any_left = 1;
  for (int first = 1, ended = 0; any_left && !ended; first = 0, t = until) {
    int whole = pieces_of_lanes(walk, &t, start + all, all, first, &until, &h);
    mean_inputs_of_lanes(walk, k, &t, &h, alone && whole, first, u);
    walk->functions->rk4_substep(&t, walk->x, u, walk->p, &h, next, roughness);
    int open = rough_lanes(walk, roughness, rough);
    for (int l = 0; open && l < LANES; l++)
      if (rough[l]) settle(walk, l, k, LANE(t, l), LANE(h, l), next);
    memcpy(walk->x, next, m->nx * sizeof(Lanes));
    if (open) any_left = follow(walk);
    ended = 1;
    for (int l = 0; !whole && l < LANES; l++) ended = ended && !(LANE(until, l) < start + all);
  }
  return any_left;
}

static int cross_lanes(Walk *walk, long long k) {
  const double *time = walk->run->time;
  double dt = time[k + 1] - time[k];
  long long n = substeps_in(walk->run, dt);
  int any_left = 1;
  for (long long i = 0; i < n && any_left; i++)
    any_left = substep_of_lanes(walk, k, time[k] + (double)i * (dt / (double)n), dt / (double)n, n == 1);
  return any_left;
}

/* ---- samples ---- */

static void keep_lane(Walk *walk, int lane, long long k, const Lanes *y) {
  const Model *m = walk->model;
  long long row = lane * walk->run->samples + k;
  for (int i = 0; walk->y && i < m->ny; i++) walk->y[row * m->ny + i] = LANE(y[i], lane);
  for (int i = 0; walk->x_out && i < m->nx; i++) walk->x_out[row * m->nx + i] = LANE(walk->x[i], lane);
}

static void add_squares(Walk *walk, long long k, const Lanes *y) {
  const Model *m = walk->model;
  for (int i = 0; i < m->ny; i++) {
    double measured = walk->measured[k * m->ny + i];
    for (int half = 0; measured * 0.0 == 0.0 && half < 2; half++) {
      Vector r = y[i].half[half] - measured;
      walk->squares[i].half[half] += r * r;
    }
  }
}

/* Outputs at sample k; lanes in which they are not finite stop. 0 when none is left. */
static int look_at_lanes(Walk *walk, long long k) {
  const Model *m = walk->model;
  double t = walk->run->time[k], x[m->nx + 1];
  Lanes u[m->nu + 1], y[m->ny + 1], zero = in_all(0.0), t_lanes = in_all(t);
  int blown = 0;
  inputs_of_lanes_at_sample(walk, k, u);
  walk->functions->output(&t_lanes, walk->x, u, walk->p, y);
  for (int i = 0; i < m->ny; i++)
    for (int half = 0; half < 2; half++) zero.half[half] += y[i].half[half] * 0.0;
  for (int l = 0; l < LANES; l++) {
    if (!walk->running[l]) continue;
    keep_lane(walk, l, k, y);
    if (LANE(zero, l) == 0.0) continue;
    take_lane(walk, walk->x, l, x);
    stop_lane(walk, l, 2, t, x);
    blown = 1;
  }
  if (walk->left) add_squares(walk, k, y);
  return !blown || follow(walk);
}

static void walk_lanes(Walk *walk, int count, const double *x0) {
  const Model *m = walk->model;
  Lanes x[m->nx + 1], p[m->np + 1], squares[m->ny + 1];
  long long samples = walk->run->samples;
  int no_memory = 0;
  walk->x = x, walk->p = p, walk->squares = squares;
  memset(squares, 0, sizeof squares);
  for (int l = 0; l < LANES; l++) {
    int set = l < count ? l : 0;
    if (l) walk->run[l] = *walk->run, walk->run[l].p = walk->run->p + set * m->np;
    for (int i = 0; i < m->nx; i++) LANE(walk->x[i], l) = x0[set * m->nx + i];
    for (int i = 0; i < m->np; i++) LANE(walk->p[i], l) = walk->run[l].p[i];
    walk->running[l] = -(l < count);
  }
  for (int l = 0; l < LANES; l++) no_memory |= open_run(walk->run + l);
  for (int l = 0; l < count; l++) walk->status[l] = 0;
  for (int l = 0; no_memory && l < count; l++) stop_lane(walk, l, no_memory, walk->run->time[0], x0 + l * m->nx);
  int any_left = follow(walk);
  for (long long k = 0; any_left && k < samples; k++)
    any_left = look_at_lanes(walk, k) && k + 1 < samples && cross_lanes(walk, k);
  for (int l = 0; walk->left && l < count; l++)
    for (int i = 0; i < m->ny; i++) walk->left[l * m->ny + i] = LANE(squares[i], l);
  for (int l = 0; l < LANES; l++) close_run(walk->run + l);
}

/* task with p (sets, np); x0 (sets, nx), measured (samples, ny) or null. What is asked for, else null: y (sets, samples,
   ny), x (sets, samples, nx), squares (sets, ny) of what is left where something was measured. A run that stopped leaves
   its rows from there on as they were. where (sets, nx + 1), status (sets). */
EXPORT void propagate_lanes(const Task *task, const SideBySide *functions, long long sets, long long samples,
                            const double *x0, const double *measured, double *y, double *x, double *squares,
                            double *where, int *status) {
  const Model *m = task->model;
  for (long long s = 0; s < sets; s += LANES) {
    Walk walk = {m, functions, .measured = measured, .where = where + s * (m->nx + 1), .status = status + s};
    walk.run[0] = (Run){m, samples, task->time, task->u, task->p + s * m->np, task->control};
    walk.y = y ? y + s * samples * m->ny : 0;
    walk.x_out = x ? x + s * samples * m->nx : 0;
    walk.left = squares ? squares + s * m->ny : 0;
    walk_lanes(&walk, sets - s < LANES ? (int)(sets - s) : LANES, x0 + s * m->nx);
  }
}
