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

/* Inputs along a piece without a jump or a kink: u + slope (t - from). */
typedef struct {
  double from, u[NU + 1], slope[NU + 1];
} Piece;

/* What a step works on: slopes of the stages, their derivatives (rows as in sensitivities.c), the matrix in factors. */
typedef struct {
  double k[STAGES][NX + 1], factors[NX * NX + 1];
  int pivots[NX + 1];
#if NT > 0
  double dk[STAGES][NS * LD + 1];
#endif
} Stages;

/* Inputs at time t, and their rates to dead times. */
static void inputs_in(const Piece *piece, double t, double *u, double *du) {
  for (int j = 0; j < NU; j++) u[j] = piece->u[j] + piece->slope[j] * (t - piece->from);
  for (int m = 0; m < ND; m++) du[m] = -piece->slope[DEAD_INPUT[m]];
}

/* x' and the nonzeros of df/dx at (t, x); those of the other derivatives too, where there are any. */
static void rates_and_jacobian(Run *run, double t, const double *x, const double *u, double *xdot, double *fx) {
  double fp[FP_NNZ + 1], fu[FU_NNZ + 1];
  const double *arg[RATE_ARG] = {&t, x, u, run->p};
  double *res[RATE_RES] = {xdot, fx, fp, fu};
  linear_rate(arg, res, run->integers, run->work, 0);
}

/* ---- 1 - h g J in units of the states, in factors by elimination with row pivots ---- */

static int factorise(double *a, int *pivots) {
  for (int c = 0; c < NX; c++) {
    int best = c;
    for (int i = c + 1; i < NX; i++)
      if (fabs(a[i * NX + c]) > fabs(a[best * NX + c])) best = i;
    pivots[c] = best;
    if (!(fabs(a[best * NX + c]) > 0.0)) return 1;
    for (int j = 0; best != c && j < NX; j++) {
      double kept = a[c * NX + j];
      a[c * NX + j] = a[best * NX + j];
      a[best * NX + j] = kept;
    }
    for (int i = c + 1; i < NX; i++) {
      double factor = a[i * NX + c] /= a[c * NX + c];
      if (factor != 0.0)
        for (int j = c + 1; j < NX; j++) a[i * NX + j] -= factor * a[c * NX + j];
    }
  }
  return 0;
}

static int factorise_stage(Stages *s, const double *fx, double hg) {
#define ADD_X(e, i, j) s->factors[(i) * NX + (j)] -= hg * fx[e] * NOMINAL[j] / NOMINAL[i];
  memset(s->factors, 0, NX * NX * sizeof(double));
  for (int i = 0; i < NX; i++) s->factors[i * NX + i] = 1.0;
  FX_EACH(ADD_X)
#undef ADD_X
  return factorise(s->factors, s->pivots);
}

/* Solves for `columns` right sides, row by row `row` apart, in place. */
static inline void solve(const Stages *s, double *restrict b, int columns, int row) {
  for (int i = 0; i < NX; i++)
    for (int c = 0; c < columns; c++) b[i * row + c] /= NOMINAL[i];
  for (int i = 0; i < NX; i++)
    for (int c = 0; s->pivots[i] != i && c < columns; c++) {
      double kept = b[i * row + c];
      b[i * row + c] = b[s->pivots[i] * row + c];
      b[s->pivots[i] * row + c] = kept;
    }
  for (int i = 1; i < NX; i++)
    for (int j = 0; j < i; j++) {
      double factor = s->factors[i * NX + j];
      for (int c = 0; factor != 0.0 && c < columns; c++) b[i * row + c] -= factor * b[j * row + c];
    }
  for (int i = NX - 1; i >= 0; i--) {
    for (int j = i + 1; j < NX; j++) {
      double factor = s->factors[i * NX + j];
      for (int c = 0; factor != 0.0 && c < columns; c++) b[i * row + c] -= factor * b[j * row + c];
    }
    for (int c = 0; c < columns; c++) b[i * row + c] /= s->factors[i * NX + i];
  }
  for (int i = 0; i < NX; i++)
    for (int c = 0; c < columns; c++) b[i * row + c] *= NOMINAL[i];
}

/* ---- one step ---- */

#if NT > 0
static double size_of_rows(const Run *run, const double *rows, const double *change) {
  double sum = 0.0;
  for (int c = 0; c < NT; c++) {
    double unit = NOMINAL_FREE[c] + (FREE[c] < 0 ? 0.0 : fabs(run->p[FREE[c]]));
    for (int i = 0; i < NS; i++) {
      double part = change[i * LD + c] * unit / (NOMINAL[i] + fabs(rows[i * LD + c]) * unit);
      sum += part * part;
    }
  }
  return sqrt(sum);
}
#endif

static double size_of(const Run *run, const double *x, const double *change) {
  double sum = 0.0;
  for (int i = 0; i < NX; i++) {
    double part = change[i] / (run->unit[i] + fabs(x[i]));
    sum += part * part;
  }
  return sqrt(sum);
}

/* Stage i at time t: x becomes its state, s->k[i] its slope; 1 where Newton's method does not converge. */
static int solve_stage(Run *run, Stages *s, int i, double t, const double *u, double h, const double *base, double *x) {
  double change[NX + 1], xdot[NX + 1], fx[FX_NNZ + 1], before = INFINITY;
  for (int n = 0; n < ITERATIONS; n++) {
    rates_and_jacobian(run, t, x, u, xdot, fx);
    if (factorise_stage(s, fx, h * G)) return 1;
    for (int m = 0; m < NX; m++) change[m] = base[m] + h * G * xdot[m] - x[m];
    solve(s, change, 1, 1);
    for (int m = 0; m < NX; m++) x[m] += change[m];
    double size = size_of(run, x, change);
    if (!(size < 2 * before)) return 1; /* and where it is no number */
    if (size <= SOLVED * run->control.tolerance) { /* at a kink a quick decline tells nothing */
      for (int m = 0; m < NX; m++) s->k[i][m] = (x[m] - base[m]) / (h * G);
      return 0;
    }
    before = size;
  }
  return 1;
}

/* to (n,) += h sum of weighted slopes, which are `row` apart. */
static inline void add_slopes(int n, double *restrict to, double h, const double *weights, int stages,
                              const double *restrict k, int row) {
  for (int j = 0; j < stages; j++)
    for (int m = 0; weights[j] != 0.0 && m < n; m++) to[m] += h * weights[j] * k[j * row + m];
}

static double shortest(const Run *run) { return ldexp(run->control.step, -DEEPEST); }

/* How far the embedded method ends from this one: h sum (b_j - c_j) k_j, without what is stiff in it, which would be
   taken for an error (Hairer, Wanner, Solving Ordinary Differential Equations II, IV.8). */
static void error_of(const Stages *s, int n, double *apart, double h, const double *k, int columns, int row) {
  double weights[STAGES];
  for (int j = 0; j < STAGES; j++) weights[j] = (j < STAGES - 1 ? BEFORE[STAGES - 1][j] : G) - EMBEDDED[j];
  memset(apart, 0, n * sizeof(double));
  add_slopes(n, apart, h, weights, STAGES, k, n + 1);
  solve(s, apart, columns, row);
}

/* Stage i of the sensitivities, whose states are x: their slopes, and where they end in next. */
#if NT > 0
static int derive_stage(Run *run, Stages *s, const Piece *piece, int i, double at, double h, const double *x,
                        const double *dx, double *next) {
  double rows[NS * LD + 1], seeds[NS * LD + 1], fx[FX_NNZ + 1], xdot[NX + 1], u[NU + 1], du[ND + 1];
  inputs_in(piece, at, u, du);
  memcpy(seeds, dx, NS * LD * sizeof(double));
  add_slopes(NS * LD, seeds, h, BEFORE[i], i, s->dk[0], NS * LD + 1);
  linear_stage(run, at, x, u, seeds, du, xdot, rows, fx);
  if (factorise_stage(s, fx, h * G)) return 1;
  solve(s, rows, NT, LD);
  memcpy(s->dk[i], rows, NS * LD * sizeof(double));
  for (int m = 0; m < NS * LD; m++) next[m] = seeds[m] + h * G * rows[m];
  return 0;
}
#endif

/* A trial from z to next; its error in units of the tolerance, infinite where a stage has no solution. */
static double trial(Run *run, Stages *s, const Piece *piece, double t, double h, int size, const double *z,
                    double *next) {
  double u[NU + 1], du[ND + 1], base[NX + 1], apart[MOVING + 1];
  for (int i = 1; i < STAGES; i++) {
    double at = t + STAGE_AT[i] * h;
    inputs_in(piece, at, u, du);
    memcpy(base, z, NX * sizeof(double));
    add_slopes(NX, base, h, BEFORE[i], i, s->k[0], NX + 1);
    for (int m = 0; m < NX; m++) next[m] = base[m] + h * G * s->k[i - 1][m];
    if (solve_stage(run, s, i, at, u, h, base, next)) return INFINITY;
#if NT > 0
    if (size > NX && derive_stage(run, s, piece, i, at, h, next, z + NX, next + NX)) return INFINITY;
#endif
  }
  if (not_finite(next, size)) return INFINITY;
  error_of(s, NX, apart, h, s->k[0], 1, 1);
  double error = size_of(run, next, apart) / run->control.tolerance;
#if NT > 0
  if (size > NX && h > shortest(run)) { /* at a kink they jump */
    error_of(s, NS * LD, apart, h, s->dk[0], NT, LD);
    error = fmax(error, size_of_rows(run, next + NX, apart) / (DERIVED * run->control.tolerance));
  }
#endif
  return error;
}

/* Slopes at the beginning of a piece; later the last stage of a step is the first of the next. */
static void begin_piece(Run *run, Stages *s, const Piece *piece, double t, int size, double *z) {
  double fx[FX_NNZ + 1], u[NU + 1], du[ND + 1];
  inputs_in(piece, t, u, du);
#if NT > 0
  if (size > NX) {
    linear_stage(run, t, z, u, z + NX, du, s->k[0], s->dk[0], fx);
    return;
  }
#endif
  rates_and_jacobian(run, t, z, u, s->k[0], fx);
}

static double growth_after(double error) {
  if (!(error < INFINITY)) return AFRESH;
  return fmin(MOST_GROWTH, fmax(LEAST_GROWTH, SAFETY * pow(error, -0.25)));
}

/* From t to the end of a piece in steps as long as the tolerance allows; z moves along. */
static int through_piece(Run *run, Stages *s, const Piece *piece, double end, int size, double *z) {
  double next[MOVING + 1], t = piece->from, least = 0.5 * shortest(run);
  begin_piece(run, s, piece, t, size, z);
  if (!(run->ahead > 0.0)) run->ahead = end - t;
  while (t < end) {
    int last = run->ahead > 0.99 * (end - t);
    double h = last ? end - t : run->ahead, error = trial(run, s, piece, t, h, size, z, next);
    double growth = growth_after(error);
    run->reached = t;
    if ((run->trials[0] -= 1) < 0) return not_finite(next, NX) ? 1 : 3;
    if (error > 1.0) {
      run->ahead = h * fmin(growth, SAFETY);
      if (run->ahead < least) return not_finite(next, NX) ? 1 : 3;
      continue;
    }
    if (!last || growth * h > run->ahead || growth < 1.0) run->ahead = growth * h;
    t = last ? end : t + h;
    memcpy(z, next, size * sizeof(double));
    memcpy(s->k[0], s->k[STAGES - 1], NX * sizeof(double));
#if NT > 0
    if (size > NX) memcpy(s->dk[0], s->dk[STAGES - 1], NS * LD * sizeof(double));
#endif
  }
  return 0;
}

static int through(Run *run, long long k, double t, double h, int size, const double *z, double *next) {
  Piece piece = {t};
  Stages s;
  inputs_behind(run, k, t, piece.u, piece.slope);
  memcpy(next, z, size * sizeof(double));
  int status = through_piece(run, &s, &piece, t + h, size, next);
  return status ? status : not_finite(next, NX);
}

static int step_state(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  return through(run, k, t, h, NX, z, next);
}

#if NT > 0
static int step_tangent(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  return through(run, k, t, h, MOVING, z, next);
}
#endif

static int refine(Run *run, Step *step, int size, long long k, double t, double h, double *z, int judged) {
  return 3;
}
