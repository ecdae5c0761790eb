/* Walks LANES sets of parameters through one recording side by side. Stands behind driver.c and vectors.c, and behind

     rk4_lanes    (t, x, u, p, h) -> x, roughness
     output_lanes (t, x, u, p) -> y

   Every lane is the run that it would be alone: it has its dead times, refines its own rough steps and stops by itself.
   A lane that stopped, or never had a set, follows one that runs, so that nobody waits for its infinite numbers. */

typedef struct {
  Run run[LANES];
  Lanes x[NX + 1], p[NP + 1];
  long long running[LANES]; /* -1 or 0 */
  int lead;                /* the first lane that runs */
  const double *measured;  /* (samples, NY) */
  double *y, *x_out;       /* (lanes, samples, NY), (lanes, samples, NX) or null */
  double *squares, *where; /* (lanes, NY) or null, (lanes, NX + 1) */
  int *status;
} Walk;

static void take_lane(const Lanes *z, int lane, double *x) {
  for (int i = 0; i < NX; i++) x[i] = LANE(z[i], lane);
}

/* Lanes that do not run follow the first that does; 0 when none is left. */
static int follow(Walk *walk) {
  for (walk->lead = 0; walk->lead < LANES && !walk->running[walk->lead];) walk->lead++;
  for (int l = 0; walk->lead < LANES && l < LANES; l++) {
    if (walk->running[l]) continue;
    for (int i = 0; i < NX; i++) LANE(walk->x[i], l) = LANE(walk->x[i], walk->lead);
    for (int i = 0; i < NP; i++) LANE(walk->p[i], l) = LANE(walk->p[i], walk->lead);
  }
  return walk->lead < LANES;
}

static void stop_lane(Walk *walk, int lane, int status, double t, const double *x) {
  walk->status[lane] = stopped(status, t, x, walk->where + lane * (NX + 1));
  walk->running[lane] = 0;
}

/* ---- inputs: those without a dead time are the same for all ---- */

/* Over the piece of each lane; one whose substep has ended keeps what it had. */
static void mean_inputs_of_lanes(Walk *walk, long long k, const Lanes *t, const Lanes *h, int whole, int first, Lanes *u) {
  for (int j = 0; j < NU; j++) {
    int same = DELAY[j] < 0 && !(CUT && LINEAR[j]), lead = walk->lead;
    if (first) u[j] = in_all(mean_input(walk->run + lead, k, j, LANE(*t, lead), LANE(*h, lead), whole));
    for (int l = first ? lead + 1 : 0; !same && l < LANES; l++)
      if (walk->running[l] && LANE(*h, l) > 0.0)
        LANE(u[j], l) = mean_input(walk->run + l, k, j, LANE(*t, l), LANE(*h, l), whole);
  }
}

static void inputs_of_lanes_at_sample(Walk *walk, long long k, Lanes *u) {
  double seen[NU + 1], slope;
  inputs_at_sample(walk->run + walk->lead, k, seen);
  for (int j = 0; j < NU; j++) {
    u[j] = in_all(seen[j]);
    for (int l = walk->lead + 1; DELAY[j] >= 0 && l < LANES; l++) {
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
    for (int i = 0; i < NX; i++) {
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
  Run *run = walk->run + lane;
  double x[NX + 1], end[NX + 1];
  int status;
  take_lane(walk->x, lane, x);
  run->reached = t;
  if (SMOOTH * run->control.tolerance < INFINITY) {
    status = refine(run, step_state, NX, k, t, h, x, NX);
    for (int i = 0; i < NX; i++) LANE(next[i], lane) = x[i];
  } else {
    take_lane(next, lane, end);
    status = not_finite(end, NX);
  }
  if (status) stop_lane(walk, lane, status, run->reached, x);
}

/* The next piece without a jump of every lane, from t on: where it ends, and how long it is, 0 where the substep has
   ended. Whether all are whole substeps. */
static int pieces_of_lanes(Walk *walk, const Lanes *t, double end, double all, int first, Lanes *until, Lanes *h) {
  int whole = first;
  *until = in_all(end);
  for (int l = 0; CUT && l < LANES; l++) {
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
  Lanes u[NU + 1], next[NX + 1], roughness[NX + 1], t = in_all(start), h = in_all(all), until;
  long long rough[LANES];
  int any_left = 1;
  for (int first = 1, ended = 0; any_left && !ended; first = 0, t = until) {
    int whole = pieces_of_lanes(walk, &t, start + all, all, first, &until, &h);
    mean_inputs_of_lanes(walk, k, &t, &h, alone && whole, first, u);
    rk4_lanes(&t, walk->x, u, walk->p, &h, next, roughness);
    int open = rough_lanes(walk, roughness, rough);
    for (int l = 0; open && l < LANES; l++)
      if (rough[l]) settle(walk, l, k, LANE(t, l), LANE(h, l), next);
    memcpy(walk->x, next, NX * sizeof(Lanes));
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
  long long row = lane * walk->run->samples + k;
  for (int i = 0; walk->y && i < NY; i++) walk->y[row * NY + i] = LANE(y[i], lane);
  for (int i = 0; walk->x_out && i < NX; i++) walk->x_out[row * NX + i] = LANE(walk->x[i], lane);
}

static void add_squares(Walk *walk, long long k, const Lanes *y, Lanes *squares) {
  for (int i = 0; i < NY; i++) {
    double measured = walk->measured[k * NY + i];
    for (int half = 0; measured * 0.0 == 0.0 && half < 2; half++) {
      Vector r = y[i].half[half] - measured;
      squares[i].half[half] += r * r;
    }
  }
}

/* Outputs at sample k; lanes in which they are not finite stop. 0 when none is left. */
static int look_at_lanes(Walk *walk, long long k, Lanes *squares) {
  double t = walk->run->time[k], x[NX + 1];
  Lanes u[NU + 1], y[NY + 1], zero = in_all(0.0), t_lanes = in_all(t);
  int blown = 0;
  inputs_of_lanes_at_sample(walk, k, u);
  output_lanes(&t_lanes, walk->x, u, walk->p, y);
  for (int i = 0; i < NY; i++)
    for (int half = 0; half < 2; half++) zero.half[half] += y[i].half[half] * 0.0;
  for (int l = 0; l < LANES; l++) {
    if (!walk->running[l]) continue;
    keep_lane(walk, l, k, y);
    if (LANE(zero, l) == 0.0) continue;
    take_lane(walk->x, l, x);
    stop_lane(walk, l, 2, t, x);
    blown = 1;
  }
  if (walk->squares) add_squares(walk, k, y, squares);
  return !blown || follow(walk);
}

static void walk_lanes(Walk *walk, int count, const double *x0) {
  Lanes squares[NY + 1];
  long long samples = walk->run->samples;
  int no_memory = 0;
  memset(squares, 0, sizeof squares);
  for (int l = 0; l < LANES; l++) {
    int set = l < count ? l : 0;
    if (l) walk->run[l] = *walk->run, walk->run[l].p = walk->run->p + set * NP;
    for (int i = 0; i < NX; i++) LANE(walk->x[i], l) = x0[set * NX + i];
    for (int i = 0; i < NP; i++) LANE(walk->p[i], l) = walk->run[l].p[i];
    walk->running[l] = -(l < count);
  }
  for (int l = 0; l < LANES; l++) no_memory |= open_run(walk->run + l);
  for (int l = 0; l < count; l++) walk->status[l] = 0;
  for (int l = 0; no_memory && l < count; l++) stop_lane(walk, l, no_memory, walk->run->time[0], x0 + l * NX);
  int any_left = follow(walk);
  for (long long k = 0; any_left && k < samples; k++)
    any_left = look_at_lanes(walk, k, squares) && k + 1 < samples && cross_lanes(walk, k);
  for (int l = 0; walk->squares && l < count; l++)
    for (int i = 0; i < NY; i++) walk->squares[l * NY + i] = LANE(squares[i], l);
  for (int l = 0; l < LANES; l++) close_run(walk->run + l);
}

/* p (sets, NP), x0 (sets, NX), measured (samples, NY) or null. What is asked for, else null: y (sets, samples, NY), x
   (sets, samples, NX), squares (sets, NY) of what is left where something was measured. A run that stopped leaves its rows
   from there on as they were. where (sets, NX + 1), status (sets). */
EXPORT void propagate_lanes(long long sets, long long samples, const double *time, const double *u, const double *p,
                            Control control, const double *x0, const double *measured, double *y, double *x,
                            double *squares, double *where, int *status) {
  for (long long s = 0; s < sets; s += LANES) {
    Walk walk = {.measured = measured, .where = where + s * (NX + 1), .status = status + s};
    walk.run[0] = (Run){samples, time, u, p + s * NP, control};
    walk.y = y ? y + s * samples * NY : 0;
    walk.x_out = x ? x + s * samples * NX : 0;
    walk.squares = squares ? squares + s * NY : 0;
    walk_lanes(&walk, sets - s < LANES ? (int)(sets - s) : LANES, x0 + s * NX);
  }
}
