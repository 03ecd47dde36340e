/* Cracked Jeffcott rotor in an AMB (thesis chapter 2), as an engineer would write it: plain RK4.
 * y = [int x, int y, x, y, vx, vy]; seven cosines and two sines per evaluation; records displacement and current. */
#include <math.h>
#include <stdint.h>

typedef struct {
  double mass, stiffness, damping, crack_stiffness, sag, eccentricity, phase, ks, ki, KP, KI, KD, speed;
} Parameters;

static void rhs(double t, const double *y, const Parameters *p, double *dy) {
  const double theta = p->speed * t;
  const double s = 0.5 + 2.0 / M_PI * (cos(theta) - cos(3 * theta) / 3 + cos(5 * theta) / 5 - cos(7 * theta) / 7 +
                                       cos(9 * theta) / 9);
  const double crack = 0.5 * s * p->crack_stiffness * p->sag;
  const double unbalance = p->mass * p->eccentricity * p->speed * p->speed;
  const double fx = crack * (1.0 + cos(2 * theta)) + unbalance * cos(theta + p->phase);
  const double fy = crack * sin(2 * theta) + unbalance * sin(theta + p->phase);
  const double ix = p->KP * y[2] + p->KI * y[0] + p->KD * y[4];
  const double iy = p->KP * y[3] + p->KI * y[1] + p->KD * y[5];
  dy[0] = y[2];
  dy[1] = y[3];
  dy[2] = y[4];
  dy[3] = y[5];
  dy[4] = (fx + p->ks * y[2] - p->ki * ix - p->damping * y[4] - p->stiffness * y[2]) / p->mass;
  dy[5] = (fy + p->ks * y[3] - p->ki * iy - p->damping * y[5] - p->stiffness * y[3]) / p->mass;
}

static void record(const double *y, const Parameters *p, double *row) {
  row[0] = y[2];
  row[1] = y[3];
  row[2] = p->KP * y[2] + p->KI * y[0] + p->KD * y[4];
  row[3] = p->KP * y[3] + p->KI * y[1] + p->KD * y[5];
}

/* rows: (n + 1, 4), from rest */
void run(const Parameters *p, int64_t n, double h, double *rows) {
  double y[6] = {0}, k1[6], k2[6], k3[6], k4[6], w[6];
  for (int64_t j = 0; j < n; ++j) {
    const double t = (double)j * h;
    record(y, p, rows + 4 * j);
    rhs(t, y, p, k1);
    for (int i = 0; i < 6; ++i) w[i] = y[i] + 0.5 * h * k1[i];
    rhs(t + 0.5 * h, w, p, k2);
    for (int i = 0; i < 6; ++i) w[i] = y[i] + 0.5 * h * k2[i];
    rhs(t + 0.5 * h, w, p, k3);
    for (int i = 0; i < 6; ++i) w[i] = y[i] + h * k3[i];
    rhs(t + h, w, p, k4);
    for (int i = 0; i < 6; ++i) y[i] += h / 6.0 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
  record(y, p, rows + 4 * n);
}
