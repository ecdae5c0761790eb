/* The C-EHA and its Runge-Kutta step as one would write them by hand: the measure for generated code.
   Parameters in the order of tests/simulation/flat_cehA.py. */

#include <math.h>

typedef struct {
  double gain, lag, displacement, A1, A2, V01, V02, beta, Fk, Fs, Fv, vs, v0, l, d, x0;
  double inertia, moment, ratio;
} Machine;

static Machine machine(const double *p) {
  const double m1 = p[13], m2 = p[14], L = p[15];
  Machine m = {p[0], p[1], p[2],  p[3],  p[4],  p[5],  p[6],  p[7],
               p[8], p[9], p[10], p[11], p[12], p[16], p[17], p[18]};
  m.inertia = m1 * L * L + m2 * L * L / 3;
  m.moment = (m1 + m2 / 2) * 9.80665 * L;
  m.ratio = p[4] / p[3];
  return m;
}

static void rate(const Machine *m, const double *x, double u, double *dx) {
  const double w = x[0], p1 = x[1], p2 = x[2], omega = x[4], c = cos(x[3]);
  const double s = sqrt(m->l * m->l + m->d * m->d + 2 * m->l * m->d * sin(x[3]));
  const double lever = m->l * m->d * c / s, stroke = s - m->x0, v = lever * omega, q = m->displacement * w;
  const double z = v / m->vs;
  const double friction = (m->Fk + (m->Fs - m->Fk) * exp(-z * z)) * tanh(v / m->v0) + m->Fv * v;
  dx[0] = (m->gain * u - w) / m->lag;
  dx[1] = m->beta / (m->V01 + m->A1 * stroke) * (q - m->A1 * v);
  dx[2] = m->beta / (m->V02 - m->A2 * stroke) * (m->A2 * v - q * m->ratio);
  dx[3] = omega;
  dx[4] = (lever * (p1 * m->A1 - p2 * m->A2 - friction) - m->moment * c) / m->inertia;
}

static void outputs(const Machine *m, const double *x, double *y) {
  y[0] = x[3];
  y[1] = x[0];
  y[2] = sqrt(m->l * m->l + m->d * m->d + 2 * m->l * m->d * sin(x[3])) - m->x0;
  y[3] = x[1];
  y[4] = x[2];
  y[5] = x[1] * m->A1 - x[2] * m->A2;
}

#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
void run_by_hand(long long samples, double h, const double *u, const double *p, const double *x0, double *y,
                 double *x_out) {
  const Machine m = machine(p);
  double x[5], k1[5], k2[5], k3[5], k4[5], s[5];
  for (int i = 0; i < 5; i++) x[i] = x0[i];
  for (long long k = 0; k < samples; k++) {
    for (int i = 0; i < 5; i++) x_out[5 * k + i] = x[i];
    outputs(&m, x, y + 6 * k);
    rate(&m, x, u[k], k1);
    for (int i = 0; i < 5; i++) s[i] = x[i] + h / 2 * k1[i];
    rate(&m, s, u[k], k2);
    for (int i = 0; i < 5; i++) s[i] = x[i] + h / 2 * k2[i];
    rate(&m, s, u[k], k3);
    for (int i = 0; i < 5; i++) s[i] = x[i] + h * k3[i];
    rate(&m, s, u[k], k4);
    for (int i = 0; i < 5; i++) x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
}
