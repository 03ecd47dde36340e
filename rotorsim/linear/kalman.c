/* Kalman filters and smoothers of rotorsim.linear.kalman, W systems side by side (kalman_in_c.py). */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define EACH for (int w = 0; w < W; ++w)
/* Every matrix has W lanes, the last index, but F (n, n), H (c, n) and y (c, K), which all systems share. */
typedef double (*lanes)[W];
typedef const double (*given)[W];
typedef struct {
  int64_t n, c; /* states without the input, outputs */
  const double *F, *H;
  given G, D, pole;
} sample;

/* Z (n + 1, p) = [F G; 0 pole] X. */
static void moved(const sample *s, int64_t p, given X, lanes Z) {
  const int64_t n = s->n;
  for (int64_t i = 0; i < n; ++i)
    for (int64_t a = 0; a < p; ++a) {
      double sum[W];
      EACH sum[w] = s->G[i][w] * X[n * p + a][w];
      for (int64_t j = 0; j < n; ++j) EACH sum[w] += s->F[i * n + j] * X[j * p + a][w];
      EACH Z[i * p + a][w] = sum[w];
    }
  for (int64_t a = 0; a < p; ++a) EACH Z[n * p + a][w] = s->pole[0][w] * X[n * p + a][w];
}
/* Z (c, p) = [H D] X. */
static void seen(const sample *s, int64_t p, given X, lanes Z) {
  const int64_t n = s->n;
  for (int64_t i = 0; i < s->c; ++i)
    for (int64_t a = 0; a < p; ++a) {
      double sum[W];
      EACH sum[w] = s->D[i][w] * X[n * p + a][w];
      for (int64_t j = 0; j < n; ++j) EACH sum[w] += s->H[i * n + j] * X[j * p + a][w];
      EACH Z[i * p + a][w] = sum[w];
    }
}
/* Z (r, p) = [Z +] A B of A (r, q), B (q, p); of A (q, r) where turned 1, of B (p, q) where turned 2. */
static void product(int64_t r, int64_t q, int64_t p, given A, given B, int turned, int more, lanes Z) {
  for (int64_t i = 0; i < r; ++i)
    for (int64_t a = 0; a < p; ++a) {
      double sum[W];
      EACH sum[w] = more ? Z[i * p + a][w] : 0.0;
      for (int64_t j = 0; j < q; ++j) {
        const double *x = A[turned == 1 ? j * r + i : i * q + j], *z = B[turned == 2 ? a * q + j : j * p + a];
        EACH sum[w] += x[w] * z[w];
      }
      EACH Z[i * p + a][w] = sum[w];
    }
}
/* rest (n + 1, n + 1) = [F G; 0 pole] - gain [H D]. */
static void closed(const sample *s, given gain, lanes rest) {
  const int64_t n = s->n, m = n + 1;
  for (int64_t i = 0; i < m; ++i)
    for (int64_t j = 0; j < m; ++j) {
      double sum[W];
      EACH sum[w] = j < n ? (i < n ? s->F[i * n + j] : 0.0) : (i < n ? s->G[i][w] : s->pole[0][w]);
      for (int64_t a = 0; a < s->c; ++a) EACH sum[w] -= gain[i * s->c + a][w] * (j < n ? s->H[a * n + j] : s->D[a][w]);
      EACH rest[i * m + j][w] = sum[w];
    }
}
/* gain (n + 1, c), root (c, c) of variances P (n + 1, n + 1), which are zero where they are none; HP, M (c, n + 1), S
 * (c, c): room. */
static void filter_of(const sample *s, lanes P, lanes gain, lanes root, lanes log_det, lanes HP, lanes M, lanes S) {
  const int64_t n = s->n, m = n + 1, c = s->c;
  double lost[W] = {0};
  seen(s, m, P, HP);
  for (int64_t a = 0; a < c; ++a)
    for (int64_t b = 0; b <= a; ++b) { /* H P H^T + I, and its Cholesky factor, row by row */
      double sum[W];
      EACH sum[w] = HP[a * m + n][w] * s->D[b][w] + (a == b);
      for (int64_t j = 0; j < n; ++j) EACH sum[w] += HP[a * m + j][w] * s->H[b * n + j];
      for (int64_t j = 0; j < b; ++j) EACH sum[w] -= S[a * c + j][w] * S[b * c + j][w];
      if (a == b) EACH {
        lost[w] = lost[w] || !(sum[w] > 0.5 && sum[w] < INFINITY); /* 1 at least, but for rounding */
        S[a * c + a][w] = lost[w] ? 1.0 : sqrt(sum[w]);
      }
      else EACH S[a * c + b][w] = sum[w] / S[b * c + b][w];
    }
  EACH if (lost[w]) {
    for (int64_t i = 0; i < m * m; ++i) P[i][w] = 0.0;
    for (int64_t i = 0; i < c * m; ++i) HP[i][w] = 0.0;
    for (int64_t i = 0; i < c * c; ++i) S[i][w] = i % (c + 1) == 0;
    log_det[0][w] = INFINITY;
  }
  for (int64_t b = 0; b < c; ++b)
    for (int64_t a = 0; a < c; ++a) {
      double sum[W];
      EACH sum[w] = a == b;
      for (int64_t j = b; j < a; ++j) EACH sum[w] -= S[a * c + j][w] * root[j * c + b][w];
      EACH root[a * c + b][w] = a < b ? 0.0 : sum[w] / S[a * c + a][w];
    }
  for (int64_t a = 0; a < c; ++a) EACH log_det[0][w] += 2 * log(S[a * c + a][w]);
  product(c, c, m, (given)root, (given)HP, 0, 0, M);
  product(m, c, c, (given)M, (given)root, 1, 0, HP); /* P H^T / (H P H^T + I), in the place of HP */
  moved(s, c, (given)HP, gain);
}
/* P (n + 1, n + 1) of the next sample, T, rest: room; Q (n + 1): what enters. */
static void advanced(const sample *s, given gain, given Q, lanes P, lanes T, lanes rest) {
  const int64_t m = s->n + 1;
  closed(s, gain, rest);
  product(m, m, m, (given)rest, (given)P, 0, 0, T);
  product(m, m, m, (given)T, (given)rest, 2, 0, P);
  product(m, s->c, m, gain, gain, 2, 1, P);
  for (int64_t i = 0; i < m; ++i) {
    EACH P[i * m + i][w] += Q[i][w];
    for (int64_t j = 0; j < i; ++j) EACH P[i * m + j][w] = P[j * m + i][w] = (P[i * m + j][w] + P[j * m + i][w]) / 2;
  }
}
/* N samples from variances P on; varying 0: all matrices have one sample. products (K, K), log_det. What is kept of
 * every sample, where it is not NULL: variances (n + 1, n + 1), gains (n + 1, c), roots (c, c), x (n + 1, K), v (c, K).
 * Returns 1 where there is no memory. */
EXPORT int rs_filter(int64_t N, int64_t n, int64_t c, int64_t K, int64_t varying, const double *F, given G,
                     const double *H, given D, given pole, given Q, lanes P, const double *y, lanes products,
                     lanes log_det, lanes variances, lanes gains, lanes roots, lanes x_kept, lanes v_kept) {
  const int64_t m = n + 1;
  double *memory = calloc((size_t)(W * (3 * c * m + 2 * c * c + 2 * m * m + 2 * m * K + 2 * c * K)), sizeof *memory);
  if (memory == NULL) return 1;
  lanes gain = (lanes)memory, HP = gain + m * c, M = HP + c * m, root = M + c * m, S = root + c * c, T = S + c * c;
  lanes rest = T + m * m, x = rest + m * m, next = x + m * K, e = next + m * K, v = e + c * K;
  for (int64_t k = 0; k < N; ++k, y += c * K) {
    const int64_t j = varying ? k : 0;
    const sample s = {n, c, F + j * n * n, H + j * c * n, G + j * n, D + j * c, pole};
    if (k == 0 || varying) {
      filter_of(&s, P, gain, root, log_det, HP, M, S);
      for (int64_t i = 0; gains && i < m * c; ++i) EACH gains[j * m * c + i][w] = gain[i][w];
      for (int64_t i = 0; roots && i < c * c; ++i) EACH roots[j * c * c + i][w] = root[i][w];
      for (int64_t i = 0; variances && i < m * m; ++i) EACH variances[j * m * m + i][w] = P[i][w];
    }
    seen(&s, K, (given)x, e);
    for (int64_t i = 0; i < c * K; ++i) EACH e[i][w] = y[i] - e[i][w];
    product(c, c, K, (given)root, (given)e, 0, 0, v);
    product(K, c, K, (given)v, (given)v, 1, 1, products);
    for (int64_t i = 0; x_kept && i < m * K; ++i) EACH x_kept[k * m * K + i][w] = x[i][w];
    for (int64_t i = 0; v_kept && i < c * K; ++i) EACH v_kept[k * c * K + i][w] = v[i][w];
    moved(&s, K, (given)x, next);
    product(m, c, K, (given)gain, (given)e, 0, 1, next);
    lanes last = x;
    x = next, next = last;
    if (varying) advanced(&s, (given)gain, Q, P, T, rest);
  }
  if (!varying) EACH log_det[0][w] *= (double)N;
  free(memory);
  return 0;
}
/* Back from the last sample: x (N, n + 1, K), predicted, becomes what all samples tell; spread (N): variance of d. */
EXPORT int rs_smooth(int64_t N, int64_t n, int64_t c, int64_t K, int64_t varying, const double *F, given G,
                     const double *H, given D, given pole, given variances, given gains, given roots, lanes x, given v,
                     lanes spread) {
  const int64_t m = n + 1;
  double *memory = calloc((size_t)(W * (c * m + 3 * m * m + 2 * m * K + m)), sizeof *memory);
  if (memory == NULL) return 1;
  lanes M = (lanes)memory, rest = M + c * m, V = rest + m * m, T = V + m * m, r = T + m * m, next = r + m * K;
  lanes q = next + m * K;
  for (int64_t k = N - 1; k >= 0; --k) {
    const int64_t j = varying ? k : 0;
    const sample s = {n, c, F + j * n * n, H + j * c * n, G + j * n, D + j * c, pole};
    given P = variances + j * m * m, root = roots + j * c * c;
    if (k == N - 1 || varying) {
      closed(&s, gains + j * m * c, rest);
      for (int64_t a = 0; a < c; ++a)
        for (int64_t i = 0; i < m; ++i) {
          double sum[W] = {0};
          for (int64_t b = 0; b < c; ++b) EACH sum[w] += root[a * c + b][w] * (i < n ? s.H[b * n + i] : s.D[b][w]);
          EACH M[a * m + i][w] = sum[w];
        }
    }
    product(m, m, K, (given)rest, (given)r, 1, 0, next);
    product(m, c, K, (given)M, v + k * c * K, 1, 1, next);
    lanes last = r;
    r = next, next = last;
    product(m, m, m, (given)rest, (given)V, 1, 0, T);
    product(m, m, m, (given)T, (given)rest, 0, 0, V);
    product(m, c, m, (given)M, (given)M, 1, 1, V);
    product(m, m, K, P, (given)r, 0, 1, x + k * m * K);
    product(m, m, 1, (given)V, P + n * m, 0, 0, q);
    EACH spread[k][w] = P[n * m + n][w];
    for (int64_t i = 0; i < m; ++i) EACH spread[k][w] -= P[n * m + i][w] * q[i][w];
  }
  free(memory);
  return 0;
}
