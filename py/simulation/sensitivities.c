/* Walks with forward sensitivities: stands behind driver.c.

   Rows of length ld, one column per free parameter or start state. ns of the nx states have a row: those that are kept,
   where nothing that is measured depends on the others. */

/* d mean / d Td = (u(a) - u(b)) / h of inputs that are linear in between: held ones are constant in a step. */
static void mean_input_rates(Run *run, double t, double h, double *rate) {
  const Model *m = run->model;
  for (int n = 0; n < m->nd; n++) {
    int j = m->dead_input[n];
    double a = t - delay_of(run, j), slope;
    rate[n] = m->linear[j] ? (input_at(run, j, a, 0, &slope) - input_at(run, j, a + h, 0, &slope)) / h : 0.0;
  }
}

static void input_rates_at_sample(Run *run, long long k, double *rate) {
  const Model *m = run->model;
  for (int n = 0; n < m->nd; n++) {
    double slope;
    input_at(run, m->dead_input[n], run->time[k] - delay_of(run, m->dead_input[n]), 0, &slope);
    rate[n] = -slope;
  }
}

typedef double Oct __attribute__((vector_size(64), aligned(8), may_alias));
typedef double Quad __attribute__((vector_size(32), aligned(8), may_alias));
typedef double Pair __attribute__((vector_size(16), aligned(8), may_alias));

/* row i = A times the seeds dx, from column c on, as many columns at once as stand side by side in a Wide. */
#define MULTIPLY(Wide)                                                               \
  for (const int side = sizeof(Wide) / sizeof(double); c + side <= ld; c += side) {  \
    Wide sum = {0.0};                                                                \
    for (int n = A->first[i]; n < A->first[i + 1]; n++)                              \
      sum += by_x[A->at[n]] * *(const Wide *)(dx + A->column[n] * ld + c);           \
    *(Wide *)(row + c) = sum;                                                        \
  }

/* A function at (t, x) and its derivative to theta along dx: rows (height, ld) = by_x dx + by_p + by_u du. */
static void derive(Run *run, const Linear *f, int height, const double *t, const double *x, const double *u,
                   const double *dx, const double *du, double *value, double *by_x, double *rows) {
  const Model *m = run->model;
  const Sparse *A = &f->x, *B = &f->p, *C = &f->u;
  double by_p[B->nonzeros + 1], by_u[C->nonzeros + 1];
  int ld = m->ld;
  run->res[0] = value, run->res[1] = by_x, run->res[2] = by_p, run->res[3] = by_u;
  call(run, f->function, t, x, u);
  for (int i = 0; i < height; i++) {
    double *row = rows + i * ld;
    int c = 0;
    MULTIPLY(Oct)
    MULTIPLY(Quad)
    MULTIPLY(Pair)
    for (int n = B->first[i]; n < B->first[i + 1]; n++) row[B->column[n]] += by_p[B->at[n]];
    for (int n = C->first[i]; n < C->first[i + 1]; n++)
      row[m->dead_column[C->column[n]]] += by_u[C->at[n]] * du[C->column[n]];
  }
}

/* One stage: x' and its derivative to theta, rows = d x' / d theta, at (x, dx); fx: nonzeros of df/dx. */
static void linear_stage(Run *run, double t, const double *x, const double *u, const double *dx, const double *du,
                         double *xdot, double *rows, double *fx) {
  derive(run, &run->model->rate, run->model->ns, &t, x, u, dx, du, xdot, fx, rows);
}

/* x' and the nonzeros of df/dx at (t, x). */
static void rates_and_jacobian(Run *run, double t, const double *x, const double *u, double *xdot, double *fx) {
  const Linear *rate = &run->model->rate;
  double fp[rate->p.nonzeros + 1], fu[rate->u.nonzeros + 1];
  run->res[0] = xdot, run->res[1] = fx, run->res[2] = fp, run->res[3] = fu;
  call(run, rate->function, &t, x, u);
}

/* Where late inputs jump at t, a longer dead time means the slope of before for a while, not that of behind. */
static void derive_jumps(Run *run, long long k, double t, const double *x, double *dx) {
  const Model *m = run->model;
  double behind[m->nu + 1], before[m->nu + 1], slopes[m->nu + 1], slope;
  double rate[2][m->nx + 1], fx[m->rate.x.nonzeros + 1];
  inputs_behind(run, k, t, behind, slopes);
  for (int d = 0; d < m->nd; d++) {
    int c = m->dead_column[d], known = 0, jumps = 0;
    for (int n = 0; n < d; n++) known |= m->dead_column[n] == c;
    memcpy(before, behind, m->nu * sizeof(double));
    for (int n = d; n < m->nd; n++)
      if (m->dead_column[n] == c) {
        int j = m->dead_input[n];
        if (!m->linear[j]) before[j] = input_at(run, j, t - delay_of(run, j), 0, &slope);
        jumps |= before[j] != behind[j];
      }
    if (known || !jumps) continue;
    rates_and_jacobian(run, t, x, before, rate[0], fx);
    rates_and_jacobian(run, t, x, behind, rate[1], fx);
    for (int i = 0; i < m->ns; i++) dx[i * m->ld + c] += rate[0][m->kept[i]] - rate[1][m->kept[i]];
  }
}

static Step implicit_tangent; /* in implicit.c */

static int explicit_tangent(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  const Model *m = run->model;
  const double *x = z, *dx = z + m->nx;
  int nx = m->nx, many = m->ns * m->ld;
  double u[m->nu + 1], du[m->nd + 1];
  double k1[nx + 1], k2[nx + 1], k3[nx + 1], k4[nx + 1], xs[nx + 1], roughness[nx + 1], fx[m->rate.x.nonzeros + 1];
  double d1[many + 1], d2[many + 1], d3[many + 1], d4[many + 1], ds[many + 1];
  mean_inputs(run, k, t, h, whole, u);
  mean_input_rates(run, t, h, du);
  linear_stage(run, t, x, u, dx, du, k1, d1, fx);
  combine(nx, xs, x, h / 2, k1);
  combine(many, ds, dx, h / 2, d1);
  linear_stage(run, t + h / 2, xs, u, ds, du, k2, d2, fx);
  combine(nx, xs, x, h / 2, k2);
  combine(many, ds, dx, h / 2, d2);
  linear_stage(run, t + h / 2, xs, u, ds, du, k3, d3, fx);
  combine(nx, xs, x, h, k3);
  combine(many, ds, dx, h, d3);
  linear_stage(run, t + h, xs, u, ds, du, k4, d4, fx);
  weigh(nx, next, x, h, k1, k2, k3, k4);
  roughness_of(nx, roughness, h, k1, k2, k3, k4);
  weigh(many, next + nx, dx, h, d1, d2, d3, d4);
  return judged(run, x, next, roughness);
}

/* dy = dh/dx dx + dh/dp + dh/du du at sample k. */
static int write_linear_output(Run *run, long long k, const double *x, const double *dx, double *y, double *dy) {
  const Model *m = run->model;
  double u[m->nu + 1], du[m->nd + 1], hx[m->seen.x.nonzeros + 1], rows[m->ny * m->ld + 1];
  inputs_at_sample(run, k, u);
  input_rates_at_sample(run, k, du);
  derive(run, &m->seen, m->ny, run->time + k, x, u, dx, du, y, hx, rows);
  for (int i = 0; i < m->ny; i++) memcpy(dy + i * m->nt, rows + i * m->ld, m->nt * sizeof(double));
  return not_finite(y, m->ny) ? 2 : 0;
}

/* Squares, their gradient and the upper triangle of their Gauss-Newton Hessian gain what sample k leaves. */
static void add_expansion(Sum *sum, int nt, long long k, const double *y, const double *restrict dy) {
  double r;
  for (int i = 0; i < sum->outputs; i++) {
    if (!residual(sum, k, i, y, &r)) continue;
    const double *restrict row = dy + i * nt;
    double *restrict gradient = sum->gradient + i * nt, *restrict hessian = sum->hessian + i * nt * nt;
    sum->squares[i] += r * r;
    sum->beyond |= sum->limit && sum->squares[i] > sum->limit[i];
    for (int c = 0; c < nt; c++) {
      gradient[c] += r * row[c];
      for (int d = c; d < nt; d++) hessian[c * nt + d] += row[c] * row[d];
    }
  }
}

/* One run with sensitivities; as `walk`. */
static int walk_tangent(Run *run, const double *x0, const double *dx0, double *y, double *dy, double *x_out,
                        double *dx_out, Sum *sum, double *where) {
  const Model *m = run->model;
  const double *time = run->time;
  double x[moving(m) + 1], *dx = x + m->nx;
  Step *step = m->implicit ? implicit_tangent : explicit_tangent;
  int status = open_run(run);
  FLUSH();
  memcpy(x, x0, m->nx * sizeof(double));
  memset(dx, 0, m->ns * m->ld * sizeof(double));
  for (int i = 0; i < m->ns; i++) memcpy(dx + i * m->ld, dx0 + m->kept[i] * m->nt, m->nt * sizeof(double));
  for (long long k = 0; k < run->samples && !status; k++) {
    long long row = sum ? 0 : k;
    memcpy(x_out + row * m->nx, x, m->nx * sizeof(double));
    for (int i = 0; dx_out && i < m->ns; i++)
      memcpy(dx_out + (row * m->nx + m->kept[i]) * m->nt, dx + i * m->ld, m->nt * sizeof(double));
    if ((status = write_linear_output(run, k, x, dx, y + row * m->ny, dy + row * m->ny * m->nt)))
      stopped(run, status, time[k], x, where);
    if (sum) add_expansion(sum, m->nt, k, y, dy);
    if (sum && sum->beyond) status = 1;
    if (k + 1 == run->samples || status) break;
    if ((status = cross(run, step, moving(m), k, x))) stopped(run, status, run->reached, x, where);
  }
  close_run(run);
  RESTORE();
  return status;
}

/* dx0 (nx, nt); y (samples, ny), dy (samples, ny, nt), x (samples, nx), dx (samples, nx, nt; rows kept) or null. */
EXPORT int propagate_tangent(const Task *task, long long samples, const double *x0, const double *dx0, double *y,
                             double *dy, double *x_out, double *dx_out, double *where) {
  long long cut[3] = {0, 0, samples};
  Run run = run_of(task, cut);
  return walk_tangent(&run, x0, dx0, y, dy, x_out, dx_out, 0, where);
}

/* dx0 (segments, nx, nt); sums by output, all zero before: squares (segments, ny), their gradient (segments, ny, nt) and
   hessian (segments, ny, nt, nt), both halved; squares are not a number where a run stopped or one of them passed its
   limit (segments, ny; or null), infinite where it became dear. */
EXPORT void propagate_expansions(const Task *task, long long segments, const long long *cuts, const double *x0,
                                 const double *dx0, const double *measured, const double *limits, double *squares,
                                 double *gradient, double *hessian) {
  const Model *m = task->model;
  int nx = m->nx, ny = m->ny, nt = m->nt;
  double y[ny + 1], dy[ny * nt + 1], x[nx + 1], where[nx + 1];
  for (long long s = 0; s < segments; s++) {
    Run run = run_of(task, cuts + 3 * s);
    Sum sum = sum_of(task, cuts + 3 * s, measured, limits ? limits + s * ny : 0);
    sum.squares = squares + s * ny, sum.gradient = gradient + s * ny * nt, sum.hessian = hessian + s * ny * nt * nt;
    int status = walk_tangent(&run, x0 + s * nx, dx0 + s * nx * nt, y, dy, x, 0, &sum, where);
    for (int i = 0; i < ny; i++) {
      double *H = sum.hessian + i * nt * nt;
      if (status || sum.squares[i] == INFINITY) sum.squares[i] = status == DEAR ? INFINITY : NAN;
      for (int c = 0; c < nt; c++)
        for (int d = 0; d < c; d++) H[c * nt + d] = H[d * nt + c];
    }
  }
}
