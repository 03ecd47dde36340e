/* FE rotor on rigid supports (thesis chapter 4), plain RK4 in two planes, ends pinned: N unknowns a plane.
 * Matrices come column-major: MK = M^-1 K, MC = M^-1 C (N x N, dense) and g = M^-1 G[:, tilt of the disc].
 * With -DBANDED: K, C as bands (bandwidth 3) and a banded Cholesky factor of M instead.
 * y = [int x, int y, qx, qy, vx, vy]. Records every displacement of NODES nodes and the current. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#ifndef N
#define N 10
#endif
#define NODES (N / 2 + 1)
#define SIZE (2 + 4 * N)
#define ROW (2 * NODES + 2)
#define W 3

typedef struct {
  const double *MK, *MC, *g; /* dense: N*N, N*N, N; banded: K and C as N x (2 W + 1) rows, G[disc] alone in g[0] */
  const double *factor;      /* dense: M^-1 columns (N*N); banded: Cholesky factor L as N x (W + 1), 1/L_ii last */
  int64_t amb, crack, tilt;
  double crack_stiffness, sag, unbalance, phase, ks, ki, KP, KI, KD, speed;
  const int64_t *where; /* NODES: unknown of each node's displacement, -1 when pinned */
} Parameters;

static void forces(double t, const Parameters *p, double *crack, double *unbalance) {
  const double theta = p->speed * t;
  const double s = 0.5 + 2.0 / M_PI * (cos(theta) - cos(3 * theta) / 3 + cos(5 * theta) / 5 - cos(7 * theta) / 7 +
                                       cos(9 * theta) / 9);
  const double c = 0.5 * s * p->crack_stiffness * p->sag;
  crack[0] = c * (1.0 + cos(2 * theta));
  crack[1] = c * sin(2 * theta);
  unbalance[0] = p->unbalance * cos(theta + p->phase);
  unbalance[1] = p->unbalance * sin(theta + p->phase);
}

static void rhs(double t, const double *restrict y, const Parameters *p, double *restrict dy) {
  double crack[2], unbalance[2];
  forces(t, p, crack, unbalance);
  memcpy(dy, y + 2 + p->amb, sizeof(double));
  memcpy(dy + 1, y + 2 + N + p->amb, sizeof(double));
  memcpy(dy + 2, y + 2 + 2 * N, 2 * N * sizeof(double));
  for (int plane = 0; plane < 2; ++plane) {
    const double *q = y + 2 + plane * N, *v = y + 2 + (2 + plane) * N, *other = y + 2 + (3 - plane) * N;
    double *a = dy + 2 + (2 + plane) * N;
    const double current = p->KP * q[p->amb] + p->KI * y[plane] + p->KD * v[p->amb];
    const double at_amb = p->ks * q[p->amb] - p->ki * current + unbalance[plane];
    const double gyro = (plane == 0 ? -p->speed : p->speed) * other[p->tilt];
#ifdef BANDED
    double f[N];
    for (int i = 0; i < N; ++i) {
      double sum = 0;
      const int first = i < W ? W - i : 0, last = i >= N - W ? N - 1 - i + W : 2 * W;
      for (int j = first; j <= last; ++j)
        sum += p->MK[i * (2 * W + 1) + j] * q[i + j - W] + p->MC[i * (2 * W + 1) + j] * v[i + j - W];
      f[i] = -sum;
    }
    f[p->amb] += at_amb;
    f[p->crack] += crack[plane];
    f[p->tilt] += p->g[0] * gyro;
    for (int i = 0; i < N; ++i) {
      double sum = f[i];
      for (int j = i < W ? W - i : 0; j < W; ++j) sum -= p->factor[i * (W + 1) + j] * a[i + j - W];
      a[i] = sum * p->factor[i * (W + 1) + W];
    }
    for (int i = N - 1; i >= 0; --i) {
      double sum = a[i];
      for (int k = 1; k <= W && i + k < N; ++k) sum -= p->factor[(i + k) * (W + 1) + W - k] * a[i + k];
      a[i] = sum * p->factor[i * (W + 1) + W];
    }
#else
    const double *ca = p->factor + p->amb * N, *cc = p->factor + p->crack * N;
    double sum[N];
    for (int i = 0; i < N; ++i) sum[i] = ca[i] * at_amb + cc[i] * crack[plane] + p->g[i] * gyro;
    for (int j = 0; j < N; ++j) {
      const double *k = p->MK + j * N, *c = p->MC + j * N;
      const double qj = q[j], vj = v[j];
      for (int i = 0; i < N; ++i) sum[i] -= k[i] * qj + c[i] * vj;
    }
    memcpy(a, sum, sizeof sum);
#endif
  }
}

static void record(const double *y, const Parameters *p, double *row) {
  for (int j = 0; j < NODES; ++j) {
    const int64_t at = p->where[j];
    row[2 * j] = at < 0 ? 0.0 : y[2 + at];
    row[2 * j + 1] = at < 0 ? 0.0 : y[2 + N + at];
  }
  for (int plane = 0; plane < 2; ++plane)
    row[2 * NODES + plane] =
        p->KP * y[2 + plane * N + p->amb] + p->KI * y[plane] + p->KD * y[2 + (2 + plane) * N + p->amb];
}

/* rows: (n / every + 1, ROW), from rest */
void run(const Parameters *p, int64_t n, int64_t every, double h, double *rows) {
  static double y[SIZE], k1[SIZE], k2[SIZE], k3[SIZE], k4[SIZE], w[SIZE];
  memset(y, 0, sizeof y);
  for (int64_t j = 0; j < n; ++j) {
    const double t = (double)j * h;
    if (j % every == 0) record(y, p, rows + ROW * (j / every));
    rhs(t, y, p, k1);
    for (int i = 0; i < SIZE; ++i) w[i] = y[i] + 0.5 * h * k1[i];
    rhs(t + 0.5 * h, w, p, k2);
    for (int i = 0; i < SIZE; ++i) w[i] = y[i] + 0.5 * h * k2[i];
    rhs(t + 0.5 * h, w, p, k3);
    for (int i = 0; i < SIZE; ++i) w[i] = y[i] + h * k3[i];
    rhs(t + h, w, p, k4);
    for (int i = 0; i < SIZE; ++i) y[i] += h / 6.0 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
  if (n % every == 0) record(y, p, rows + ROW * (n / every));
}
