/* Implicit steps: stands last, where eigenvalues are too fast for explicit ones.

   A stiffly accurate, L-stable singly diagonally implicit Runge-Kutta method of order 4 with an explicit first stage,
   an embedded one of order 3 and stage order 2 (ARK4(3)6L[2]SA-ESDIRK of Kennedy, Carpenter, Applied Numerical
   Mathematics 44 (2003) 139-181). Stages are solved by Newton's method,

     X_i = B_i + h g k_i,   B_i = x + h sum_{j<i} a_ij k_j,   (1 - h g J) dX = B_i + h g f(X) - X

   and their derivatives follow from the same matrix: dk_i = (1 - h g J)^-1 (J dB_i + f_p + f_u du), the exact
   derivatives of the step. States alone decide on its length. */

#define STAGES 6
#define G 0.25
#define ITERATIONS 8    /* of Newton's method: it converges in three, or the step is too long */
#define SOLVED 1e-3     /* of the tolerance of a step: the last change in a stage */
#define SAFETY 0.9
#define LEAST_GROWTH 0.2
#define MOST_GROWTH 5.0
#define AFRESH 0.1      /* of a step after one whose stages had no solution */
#define DERIVED 100.0   /* tolerances that sensitivities may be off in a step */

static const double STAGE_AT[STAGES] = {0.0, 0.5, 83 / 250.0, 31 / 50.0, 17 / 20.0, 1.0};
static const double BEFORE[STAGES][STAGES - 1] = {
    {0},
    {G},
    {8611 / 62500.0, -1743 / 31250.0},
    {5012029 / 34652500.0, -654441 / 2922500.0, 174375 / 388108.0},
    {15267082809 / 155376265600.0, -71443401 / 120774400.0, 730878875 / 902184768.0, 2285395 / 8070912.0},
    {82889 / 524892.0, 0.0, 15625 / 83664.0, 69875 / 102672.0, -2260 / 8211.0}};
static const double EMBEDDED[STAGES] = {4586570599 / 29645900160.0,    0.0, 178811875 / 945068544.0,
                                        814220225 / 1159782912.0, -3700637 / 11593932.0, 61727 / 225920.0};

/* What a step works on: inputs along a piece without a jump or a kink, u + slope (t - from); slopes of the stages, their
   derivatives (rows as in sensitivities.c), the matrix in factors. */
typedef struct {
  double from, *u, *slope, *k[STAGES], *dk[STAGES], *factors;
  int *pivots;
} Stages;

/* Inputs at time t, and their rates to dead times. */
static void inputs_in(const Model *m, const Stages *s, double t, double *u, double *du) {
  for (int j = 0; j < m->nu; j++) u[j] = s->u[j] + s->slope[j] * (t - s->from);
  for (int n = 0; n < m->nd; n++) du[n] = -s->slope[m->dead_input[n]];
}

/* ---- 1 - h g J in units of the states, in factors by elimination with row pivots ---- */

static int factorise(int nx, double *a, int *pivots) {
  for (int c = 0; c < nx; c++) {
    int best = c;
    for (int i = c + 1; i < nx; i++)
      if (fabs(a[i * nx + c]) > fabs(a[best * nx + c])) best = i;
    pivots[c] = best;
    if (!(fabs(a[best * nx + c]) > 0.0)) return 1;
    for (int j = 0; best != c && j < nx; j++) {
      double kept = a[c * nx + j];
      a[c * nx + j] = a[best * nx + j];
      a[best * nx + j] = kept;
    }
    for (int i = c + 1; i < nx; i++) {
      double factor = a[i * nx + c] /= a[c * nx + c];
      if (factor != 0.0)
        for (int j = c + 1; j < nx; j++) a[i * nx + j] -= factor * a[c * nx + j];
    }
  }
  return 0;
}

static int factorise_stage(const Model *m, Stages *s, const double *fx, double hg) {
  const Sparse *J = &m->rate.x;
  int nx = m->nx;
  memset(s->factors, 0, nx * nx * sizeof(double));
  for (int i = 0; i < nx; i++) {
    s->factors[i * nx + i] = 1.0;
    for (int n = J->first[i]; n < J->first[i + 1]; n++)
      s->factors[i * nx + J->column[n]] -= hg * fx[J->at[n]] * m->nominal[J->column[n]] / m->nominal[i];
  }
  return factorise(nx, s->factors, s->pivots);
}

/* Solves for `columns` right sides, row by row `row` apart, in place. */
static inline void solve(const Model *m, const Stages *s, double *restrict b, int columns, int row) {
  int nx = m->nx;
  for (int i = 0; i < nx; i++)
    for (int c = 0; c < columns; c++) b[i * row + c] /= m->nominal[i];
  for (int i = 0; i < nx; i++)
    for (int c = 0; s->pivots[i] != i && c < columns; c++) {
      double kept = b[i * row + c];
      b[i * row + c] = b[s->pivots[i] * row + c];
      b[s->pivots[i] * row + c] = kept;
    }
  for (int i = 1; i < nx; i++)
    for (int j = 0; j < i; j++) {
      double factor = s->factors[i * nx + j];
      for (int c = 0; factor != 0.0 && c < columns; c++) b[i * row + c] -= factor * b[j * row + c];
    }
  for (int i = nx - 1; i >= 0; i--) {
    for (int j = i + 1; j < nx; j++) {
      double factor = s->factors[i * nx + j];
      for (int c = 0; factor != 0.0 && c < columns; c++) b[i * row + c] -= factor * b[j * row + c];
    }
    for (int c = 0; c < columns; c++) b[i * row + c] /= s->factors[i * nx + i];
  }
  for (int i = 0; i < nx; i++)
    for (int c = 0; c < columns; c++) b[i * row + c] *= m->nominal[i];
}

/* ---- one step ---- */

static double size_of_rows(const Run *run, const double *rows, const double *change) {
  const Model *m = run->model;
  double sum = 0.0;
  for (int c = 0; c < m->nt; c++) {
    double unit = m->nominal_free[c] + (m->free[c] < 0 ? 0.0 : fabs(run->p[m->free[c]]));
    for (int i = 0; i < m->ns; i++) {
      double part = change[i * m->ld + c] * unit / (m->nominal[i] + fabs(rows[i * m->ld + c]) * unit);
      sum += part * part;
    }
  }
  return sqrt(sum);
}

static double size_of(const Run *run, const double *x, const double *change) {
  double sum = 0.0;
  for (int i = 0; i < run->model->nx; i++) {
    double part = change[i] / (run->unit[i] + fabs(x[i]));
    sum += part * part;
  }
  return sqrt(sum);
}

/* Stage i at time t: x becomes its state, s->k[i] its slope; 1 where Newton's method does not converge. */
static int solve_stage(Run *run, Stages *s, int i, double t, const double *u, double h, const double *base, double *x) {
  const Model *m = run->model;
  int nx = m->nx;
  double change[nx + 1], xdot[nx + 1], fx[m->rate.x.nonzeros + 1], before = INFINITY;
  for (int n = 0; n < ITERATIONS; n++) {
    rates_and_jacobian(run, t, x, u, xdot, fx);
    if (factorise_stage(m, s, fx, h * G)) return 1;
    for (int j = 0; j < nx; j++) change[j] = base[j] + h * G * xdot[j] - x[j];
    solve(m, s, change, 1, 1);
    for (int j = 0; j < nx; j++) x[j] += change[j];
    double size = size_of(run, x, change);
    if (!(size < 2 * before)) return 1; /* and where it is no number */
    if (size <= SOLVED * run->control.tolerance) { /* at a kink a quick decline tells nothing */
      for (int j = 0; j < nx; j++) s->k[i][j] = (x[j] - base[j]) / (h * G);
      return 0;
    }
    before = size;
  }
  return 1;
}

/* to (n,) += h sum of weighted slopes. */
static inline void add_slopes(int n, double *restrict to, double h, const double *weights, int stages,
                              double *const *slopes) {
  for (int j = 0; j < stages; j++) {
    const double *restrict k = slopes[j];
    for (int i = 0; weights[j] != 0.0 && i < n; i++) to[i] += h * weights[j] * k[i];
  }
}

static double shortest(const Run *run) { return ldexp(run->control.step, -DEEPEST); }

/* How far the embedded method ends from this one: h sum (b_j - c_j) k_j, without what is stiff in it, which would be
   taken for an error (Hairer, Wanner, Solving Ordinary Differential Equations II, IV.8). */
static void error_of(const Model *m, const Stages *s, int n, double *apart, double h, double *const *slopes,
                     int columns, int row) {
  double weights[STAGES];
  for (int j = 0; j < STAGES; j++) weights[j] = (j < STAGES - 1 ? BEFORE[STAGES - 1][j] : G) - EMBEDDED[j];
  memset(apart, 0, n * sizeof(double));
  add_slopes(n, apart, h, weights, STAGES, slopes);
  solve(m, s, apart, columns, row);
}

/* Stage i of the sensitivities, whose states are x: their slopes, and where they end in next. */
static int derive_stage(Run *run, Stages *s, int i, double at, double h, const double *x, const double *dx,
                        double *next) {
  const Model *m = run->model;
  int many = m->ns * m->ld;
  double rows[many + 1], seeds[many + 1], fx[m->rate.x.nonzeros + 1], xdot[m->nx + 1], u[m->nu + 1], du[m->nd + 1];
  inputs_in(m, s, at, u, du);
  memcpy(seeds, dx, many * sizeof(double));
  add_slopes(many, seeds, h, BEFORE[i], i, s->dk);
  linear_stage(run, at, x, u, seeds, du, xdot, rows, fx);
  if (factorise_stage(m, s, fx, h * G)) return 1;
  solve(m, s, rows, m->nt, m->ld);
  memcpy(s->dk[i], rows, many * sizeof(double));
  for (int j = 0; j < many; j++) next[j] = seeds[j] + h * G * rows[j];
  return 0;
}

/* A trial from z to next; its error in units of the tolerance, infinite where a stage has no solution. */
static double trial(Run *run, Stages *s, double t, double h, int size, const double *z, double *next) {
  const Model *m = run->model;
  int nx = m->nx;
  double u[m->nu + 1], du[m->nd + 1], base[nx + 1], apart[moving(m) + 1];
  for (int i = 1; i < STAGES; i++) {
    double at = t + STAGE_AT[i] * h;
    inputs_in(m, s, at, u, du);
    memcpy(base, z, nx * sizeof(double));
    add_slopes(nx, base, h, BEFORE[i], i, s->k);
    for (int j = 0; j < nx; j++) next[j] = base[j] + h * G * s->k[i - 1][j];
    if (solve_stage(run, s, i, at, u, h, base, next)) return INFINITY;
    if (size > nx && derive_stage(run, s, i, at, h, next, z + nx, next + nx)) return INFINITY;
  }
  if (not_finite(next, size)) return INFINITY;
  error_of(m, s, nx, apart, h, s->k, 1, 1);
  double error = size_of(run, next, apart) / run->control.tolerance;
  if (size > nx && h > shortest(run)) { /* at a kink they jump */
    error_of(m, s, m->ns * m->ld, apart, h, s->dk, m->nt, m->ld);
    error = fmax(error, size_of_rows(run, next + nx, apart) / (DERIVED * run->control.tolerance));
  }
  return error;
}

/* Slopes at the beginning of a piece; later the last stage of a step is the first of the next. */
static void begin_piece(Run *run, Stages *s, double t, int size, double *z) {
  const Model *m = run->model;
  double fx[m->rate.x.nonzeros + 1], u[m->nu + 1], du[m->nd + 1];
  inputs_in(m, s, t, u, du);
  if (size > m->nx)
    linear_stage(run, t, z, u, z + m->nx, du, s->k[0], s->dk[0], fx);
  else
    rates_and_jacobian(run, t, z, u, s->k[0], fx);
}

static double growth_after(double error) {
  if (!(error < INFINITY)) return AFRESH;
  return fmin(MOST_GROWTH, fmax(LEAST_GROWTH, SAFETY * pow(error, -0.25)));
}

/* From the beginning to the end of a piece in steps as long as the tolerance allows; z moves along. */
static int through_piece(Run *run, Stages *s, double end, int size, double *z) {
  const Model *m = run->model;
  double next[moving(m) + 1], t = s->from, least = 0.5 * shortest(run);
  begin_piece(run, s, t, size, z);
  if (!(run->ahead > 0.0)) run->ahead = end - t;
  while (t < end) {
    int last = run->ahead > 0.99 * (end - t);
    double h = last ? end - t : run->ahead, error = trial(run, s, t, h, size, z, next);
    double growth = growth_after(error);
    run->reached = t;
    if ((run->trials[0] -= 1) < 0) return not_finite(next, m->nx) ? 1 : 3;
    if (error > 1.0) {
      run->ahead = h * fmin(growth, SAFETY);
      if (run->ahead < least) return not_finite(next, m->nx) ? 1 : 3;
      continue;
    }
    if (!last || growth * h > run->ahead || growth < 1.0) run->ahead = growth * h;
    t = last ? end : t + h;
    memcpy(z, next, size * sizeof(double));
    memcpy(s->k[0], s->k[STAGES - 1], m->nx * sizeof(double));
    if (size > m->nx) memcpy(s->dk[0], s->dk[STAGES - 1], m->ns * m->ld * sizeof(double));
  }
  return 0;
}

static int through(Run *run, long long k, double t, double h, int size, const double *z, double *next) {
  const Model *m = run->model;
  int nx = m->nx, many = size > nx ? m->ns * m->ld : 0, pivots[nx + 1];
  double u[m->nu + 1], slope[m->nu + 1], factors[nx * nx + 1], slopes[STAGES][nx + 1], derived[STAGES][many + 1];
  Stages s = {.from = t, .u = u, .slope = slope, .factors = factors, .pivots = pivots};
  for (int i = 0; i < STAGES; i++) s.k[i] = slopes[i], s.dk[i] = derived[i];
  inputs_behind(run, k, t, u, slope);
  memcpy(next, z, size * sizeof(double));
  int status = through_piece(run, &s, t + h, size, next);
  return status ? status : not_finite(next, nx);
}

static int implicit_state(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  return through(run, k, t, h, run->model->nx, z, next);
}

static int implicit_tangent(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  return through(run, k, t, h, moving(run->model), z, next);
}
