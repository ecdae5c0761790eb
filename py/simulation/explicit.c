/* The classical Runge-Kutta step of fourth order, and what its slopes tell of its error. */

static inline void combine(int n, double *restrict to, const double *restrict from, double factor,
                           const double *restrict rate) {
  for (int i = 0; i < n; i++) to[i] = from[i] + factor * rate[i];
}

static inline void weigh(int n, double *restrict to, const double *restrict x, double h, const double *restrict k1,
                         const double *restrict k2, const double *restrict k3, const double *restrict k4) {
  for (int i = 0; i < n; i++) to[i] = x[i] + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
}

/* As in `equations.rk4_substep`, like the whole step, to the bit. */
static inline void roughness_of(int n, double *restrict to, double h, const double *restrict k1,
                                const double *restrict k2, const double *restrict k3, const double *restrict k4) {
  for (int i = 0; i < n; i++) {
    double bend = k1[i] - k2[i] - k3[i] + k4[i], turn = 2 * (k3[i] - k2[i]);
    to[i] = h * h / 36 * (bend * bend + turn * turn);
  }
}

static inline void slopes_at(Run *run, double t, const double *x, const double *u, double *slopes) {
  run->res[0] = slopes;
  call(run, run->model->slopes, &t, x, u);
}

static int explicit_state(Run *run, long long k, double t, double h, int whole, const double *z, double *next) {
  const Model *m = run->model;
  int nx = m->nx;
  double mean[m->nu + 1], x[nx + 1], k1[nx + 1], k2[nx + 1], k3[nx + 1], k4[nx + 1], roughness[nx + 1];
  mean_inputs(run, k, t, h, whole, mean);
  slopes_at(run, t, z, mean, k1);
  combine(nx, x, z, h / 2, k1);
  slopes_at(run, t + h / 2, x, mean, k2);
  combine(nx, x, z, h / 2, k2);
  slopes_at(run, t + h / 2, x, mean, k3);
  combine(nx, x, z, h, k3);
  slopes_at(run, t + h, x, mean, k4);
  weigh(nx, next, z, h, k1, k2, k3, k4);
  roughness_of(nx, roughness, h, k1, k2, k3, k4);
  return judged(run, z, next, roughness);
}
