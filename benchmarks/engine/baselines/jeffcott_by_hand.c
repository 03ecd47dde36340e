/* The same model tuned by hand, the limit to compare with: a unit vector rotated by half a step at a time and set anew
 * every 256 steps, the series by recurrence, the forcing of t + h/2 used by two stages and that of t + h by the next step. */
#include <math.h>
#include <stdint.h>

typedef struct {
  double mass, stiffness, damping, crack_stiffness, sag, eccentricity, phase, ks, ki, KP, KI, KD, speed;
} Parameters;

typedef struct {
  double crack, ux, uy, stiffness, damping, integral;
} Prepared;

static void force(double c1, double s1, const Prepared *q, double *f) {
  const double c2 = 2 * c1 * c1 - 1, s2 = 2 * s1 * c1, d = 2 * c2;
  const double c3 = d * c1 - c1, c5 = d * c3 - c1, c7 = d * c5 - c3, c9 = d * c7 - c5;
  const double s = 0.5 + 2 / M_PI * (c1 - c3 * (1.0 / 3) + c5 * (1.0 / 5) - c7 * (1.0 / 7) + c9 * (1.0 / 9));
  const double crack = q->crack * s;
  f[0] = crack * (1 + c2) + q->ux * c1 - q->uy * s1;
  f[1] = crack * s2 + q->uy * c1 + q->ux * s1;
}

void run(const Parameters *p, int64_t n, double h, double *rows) {
  const double m = p->mass, u = p->eccentricity * p->speed * p->speed;
  const Prepared q = {0.5 * p->crack_stiffness * p->sag / m, u * cos(p->phase), u * sin(p->phase),
                      (p->stiffness - p->ks + p->ki * p->KP) / m, (p->damping + p->ki * p->KD) / m, p->ki * p->KI / m};
  double g0[2], gm[2], g1[2];
  double zx = 0, zy = 0, x = 0, y = 0, vx = 0, vy = 0;
  const double b = 0.5 * h;
  const double cd = cos(b * p->speed), sd = sin(b * p->speed);
  double c = 1.0, s = 0.0;
  force(c, s, &q, g0);
  for (int64_t j = 0; j < n; ++j) {
    double *row = rows + 4 * j;
    row[0] = x, row[1] = y;
    row[2] = p->KP * x + p->KI * zx + p->KD * vx, row[3] = p->KP * y + p->KI * zy + p->KD * vy;
    if (j % 256 == 0) c = cos(p->speed * (double)j * h), s = sin(p->speed * (double)j * h);
    const double cm = c * cd - s * sd, sm = s * cd + c * sd;
    c = cm * cd - sm * sd, s = sm * cd + cm * sd;
    force(cm, sm, &q, gm);
    force(c, s, &q, g1);
#define ACC(f, x, v, z) ((f)-q.stiffness * (x)-q.damping * (v)-q.integral * (z))
#define AXIS(i, x, v, z)                                                                  \
  {                                                                                       \
    const double a1 = ACC(g0[i], x, v, z), v2 = v + b * a1, x2 = x + b * v;               \
    const double a2 = ACC(gm[i], x2, v2, z + b * x), v3 = v + b * a2, x3 = x + b * v2;    \
    const double a3 = ACC(gm[i], x3, v3, z + b * x2), v4 = v + h * a3, x4 = x + h * v3;   \
    const double a4 = ACC(g1[i], x4, v4, z + h * x3);                                     \
    z += h / 6 * (x + 2 * (x2 + x3) + x4);                                                \
    x += h / 6 * (v + 2 * (v2 + v3) + v4);                                                \
    v += h / 6 * (a1 + 2 * (a2 + a3) + a4);                                               \
  }
    AXIS(0, x, vx, zx)
    AXIS(1, y, vy, zy)
    g0[0] = g1[0], g0[1] = g1[1];
  }
  double *row = rows + 4 * n;
  row[0] = x, row[1] = y;
  row[2] = p->KP * x + p->KI * zx + p->KD * vx, row[3] = p->KP * y + p->KI * zy + p->KD * vy;
}
