/* The C runtime of rotorsim: time loop, sample hits, random draws, bounds of states.
 *
 * It is appended to the generated functions of one diagram and layout.h, and is the same in process and in an FMU.
 * Generated before it: RS_NX states, RS_NZ discrete states, RS_NC values that depend on parameters only,
 * RS_NG values that depend on time and parameters only, RS_NA angles that may turn evenly (turning.c), RS_NY recorded
 * values, RS_NS samplers,
 * RS_NW random draws, RS_STAGES of a step, RS_WORK work space, RS_UNROLLED (1: rs_step is one straight function, for
 * which rs_step_constants computes RS_ND values that follow from the length of the step), and the functions
 * rs_constants, rs_forcing, rs_forcing_turned (with angles), rs_rhs, rs_outputs, rs_update, rs_step. With RS_STATIC
 * defined no function is exported.
 */
RS_EXPORT int64_t rs_size(void) { return RS_SIZE; }

/* Compute everything that depends on parameters only. */
RS_EXPORT void rs_prepare(const double *p, double *m) {
  rs_constants(p, m + RS_AT_C, m + RS_AT_WORK);
  m[RS_AT_D] = NAN; /* of no step */
#if RS_NA > 0
  m[RS_AT_TURN + RS_TURN_H] = NAN;
#endif
}

/* Return the forcing at an instant: where a run is just there, that of the run, in front, which stays as it is. */
static const double *rs_forcing_of(double t, const double *p, double *m) {
#if RS_NA > 0
  const double *turn = m + RS_AT_TURN;
  if (t == turn[RS_TURN_T0] + turn[RS_TURN_AT] * turn[RS_TURN_H]) return m + RS_AT_G;
#endif
  rs_forcing(t, p, m + RS_AT_C, m + RS_AT_G + RS_NG, m + RS_AT_WORK);
  return m + RS_AT_G + RS_NG;
}

/* Right-hand side dx/dt at one instant. */
RS_EXPORT void rs_derivative(double t, const double *x, const double *z, const double *p, double *m, double *xdot) {
  rs_rhs(x, z, p, m + RS_AT_C, rs_forcing_of(t, p, m), xdot, m + RS_AT_WORK);
}

/* Recorded values at one instant. */
RS_EXPORT void rs_record(double t, const double *x, const double *z, const double *p, double *m, double *y) {
  rs_outputs(x, z, p, m + RS_AT_C, rs_forcing_of(t, p, m), y, m + RS_AT_WORK);
}

/* Right-hand sides of n instants: t (n), x (n, NX), z (NZ), p (n, NP) -> xdot (n, NX). */
RS_EXPORT void rs_derivatives(int64_t n, const double *t, const double *x, const double *z, const double *p, int64_t np,
                              double *m, double *xdot) {
  const double *known = 0;
  for (int64_t k = 0; k < n; ++k) {
    const double *pk = p + k * np;
    int same = known != 0;
    for (int64_t i = 0; same && i < np; ++i) same = pk[i] == known[i];
    if (!same) rs_prepare(pk, m);
    known = pk;
    rs_derivative(t[k], x + k * RS_NX, z, pk, m, xdot + k * RS_NX);
  }
}

#if RS_NS > 0
/* Time of the next hit at or after now, of all samplers. */
static double rs_next_hit(const double *p, const double *m) {
  double next = HUGE_VAL;
  for (int s = 0; s < RS_NS; ++s) {
    const double at = m[RS_AT_COUNT + s] * p[rs_period[s]];
    if (at < next) next = at;
  }
  return next;
}

/* Carry out the hits that are due at time t (g of this instant is in place); tolerance: 1e-9 of the period. */
static void rs_hit(double t, const double *p, double *m, const double *g) {
  int any = 0;
  for (int s = 0; s < RS_NS; ++s) {
    const double period = p[rs_period[s]];
    const int due = m[RS_AT_COUNT + s] * period <= t + 1e-9 * period;
    m[RS_AT_HIT + s] = due;
    if (!due) continue;
    any = 1;
    for (int j = rs_draw_begin[s]; j < rs_draw_end[s]; ++j)
      m[RS_AT_W + j] = rs_normal((uint64_t)(int64_t)p[rs_seed[s]], (uint64_t)m[RS_AT_COUNT + s], (uint64_t)(j - rs_draw_begin[s]));
    m[RS_AT_COUNT + s] += 1.0;
  }
  if (!any) return;
  rs_update(m + RS_AT_X, m + RS_AT_Z, p, m + RS_AT_C, g, m + RS_AT_W, m + RS_AT_HIT, m + RS_AT_NEW, m + RS_AT_WORK);
  memcpy(m + RS_AT_Z, m + RS_AT_NEW, RS_NZ * sizeof(double));
}
RS_EXPORT double rs_next(const double *p, const double *m) { return rs_next_hit(p, m); }
#endif

/* Begin at time t: forcing of this instant, sample hits due. The states are in m already. */
RS_EXPORT void rs_start(double t, const double *p, double *m) {
#if RS_NA > 0
  m[RS_AT_TURN + RS_TURN_H] = NAN;
#endif
  rs_forcing(t, p, m + RS_AT_C, m + RS_AT_G, m + RS_AT_WORK);
#if RS_NS > 0
  for (int s = 0; s < RS_NS; ++s) m[RS_AT_COUNT + s] = ceil(t / p[rs_period[s]] - 1e-9);
  rs_hit(t, p, m, m + RS_AT_G);
#endif
}

/* Carry out the hits due at time t (for solvers that step outside). */
RS_EXPORT void rs_sample(double t, const double *p, double *m) {
#if RS_NS > 0
  rs_forcing(t, p, m + RS_AT_C, m + RS_AT_G, m + RS_AT_WORK);
  rs_hit(t, p, m, m + RS_AT_G);
#else
  (void)t, (void)p, (void)m;
#endif
}

/* Have what follows from the length of a step. */
static const double *rs_step_of(double h, const double *p, double *m) {
#if RS_ND > 0
  if (m[RS_AT_D] != h) rs_step_constants(h, p, m + RS_AT_C, m + RS_AT_D + 1, m + RS_AT_WORK);
#endif
  m[RS_AT_D] = h;
  (void)p;
  return m + RS_AT_D + 1;
}

/* Whether states are numbers within all bounds. */
static int rs_bounded(const double *x) {
  double a = 0.0, b = 0.0;
  int i = 0;
  for (; i + 1 < RS_NX; i += 2) a += fabs(x[i]), b += fabs(x[i + 1]);
  if (i < RS_NX) a += fabs(x[i]);
  return a + b <= RS_LARGEST;
}

/* Run steps n0..n1-1 of size h from t0; a row is recorded at the start of every step divisible by `every`.
 * Returns the number of the step reached: less than n1 when a state is beyond all bounds. */
RS_EXPORT int64_t rs_run(const double *p, double *m, int64_t n0, int64_t n1, double t0, double h, int64_t every,
                         double *rows) {
  if (n0 >= n1) return n0;
#if RS_UNROLLED && RS_NX > 0
  double x[RS_NX];
  memcpy(x, m + RS_AT_X, sizeof x);
#else
  double *x = m + RS_AT_X;
#endif
  double *z = m + RS_AT_Z, *c = m + RS_AT_C, *work = m + RS_AT_WORK, *k = m + RS_AT_K;
  double *g0 = m + RS_AT_G, *gm = g0 + RS_NG, *g1 = gm + RS_NG;
#if RS_NS == 0
  const double *d = rs_step_of(h, p, m);
#endif
  int64_t n = n0, until_row = (every - n0 % every) % every;
#if RS_NA > 0
  double turn[RS_TURN_VECTORS + RS_ANGLE * RS_NA];
  memcpy(turn, m + RS_AT_TURN, sizeof turn);
  if (turn[RS_TURN_AT] != (double)n0 || turn[RS_TURN_T0] != t0 || turn[RS_TURN_H] != h) {
    const int other = turn[RS_TURN_H] == turn[RS_TURN_H] && n1 - n0 < RS_FEW; /* steps from one instant to the next */
    turn[RS_TURN_KIND] = RS_NOT_EVEN, turn[RS_TURN_END] = (double)(other ? n1 : n0);
  }
#endif
  for (; n < n1; ++n) {
    double *row = m + RS_AT_ROW;
    if (until_row == 0) row = rows, rows += RS_NY, until_row = every;
    --until_row;
#if RS_NS > 0
    double t = t0 + (double)n * h;
    const double end = t0 + (double)(n + 1) * h;
    for (;;) {
      double stop = rs_next_hit(p, m);
      if (stop > end - 1e-9 * h) stop = end;
      rs_forcing(t + 0.5 * (stop - t), p, c, gm, work);
      rs_forcing(stop, p, c, g1, work);
      rs_step(stop - t, x, z, p, c, g0, gm, g1, rs_step_of(stop - t, p, m), row, k, work);
      double *swap = g0;
      g0 = g1, g1 = swap;
#if RS_UNROLLED && RS_NX > 0
      memcpy(m + RS_AT_X, x, sizeof x);
#endif
      rs_hit(stop, p, m, g0);
      if (stop == end) break;
      t = stop, row = m + RS_AT_ROW;
    }
#else
    const double middle = t0 + ((double)n + 0.5) * h, end = t0 + (double)(n + 1) * h;
#if RS_NA > 0
    if ((double)n >= turn[RS_TURN_END]) rs_turn_set(turn, p, t0, h, n);
    if (turn[RS_TURN_KIND] != RS_NOT_EVEN) {
      rs_turn_on(turn);
      rs_forcing_turned(middle, p, c, turn + RS_TURN_VECTORS, gm, work);
      rs_turn_on(turn);
      rs_forcing_turned(end, p, c, turn + RS_TURN_VECTORS, g1, work);
    } else
#endif
    {
      rs_forcing(middle, p, c, gm, work);
      rs_forcing(end, p, c, g1, work);
    }
    rs_step(h, x, z, p, c, g0, gm, g1, d, row, k, work);
    double *swap = g0;
    g0 = g1, g1 = swap;
#endif
    if ((n & 7) == 7) {
      if (!rs_bounded(x)) {
        ++n;
        break;
      }
    }
  }
#if RS_UNROLLED && RS_NX > 0
  memcpy(m + RS_AT_X, x, sizeof x);
#endif
#if RS_NA > 0
  turn[RS_TURN_AT] = (double)n, turn[RS_TURN_T0] = t0, turn[RS_TURN_H] = h;
  memcpy(m + RS_AT_TURN, turn, sizeof turn);
#endif
  if (g0 != m + RS_AT_G) { /* the forcing of the current instant stays in front */
    for (int i = 0; i < RS_NG; ++i) {
      const double swap = g0[i];
      g0[i] = m[RS_AT_G + i], m[RS_AT_G + i] = swap;
    }
  }
  return n;
}

#if !defined(RS_STATIC)
/* A callback at the end of every step: returns what it wants (not 0: no more steps). */
typedef struct {
  int64_t (*function)(void *);
  void *context;
  int64_t said;
} rs_callback;

/* As rs_run, step by step: at the end of each the right-hand side is asked for, so that all parts are there, and then
 * the callbacks are called. Returns the step reached: less than n1 where one wants something, or where a step ends with
 * what is no number; then none is called, and m is as before that step. held: room for m;
 * slope: (NX). */
RS_EXPORT int64_t rs_run_stepwise(const double *p, double *m, int64_t n0, int64_t n1, double t0, double h, int64_t every,
                              double *rows, double *held, double *slope, int64_t n_callbacks, rs_callback *callback) {
  for (int64_t n = n0; n < n1; ++n) {
    memcpy(held, m, RS_SIZE * sizeof(double));
    rs_run(p, m, n, n + 1, t0, h, every, rows);
    rs_derivative(t0 + (double)(n + 1) * h, m + RS_AT_X, m + RS_AT_Z, p, m, slope);
    double bad = 0.0;
    for (int i = 0; i < RS_NX; ++i) bad += 0.0 * m[RS_AT_X + i] + 0.0 * slope[i];
    if (!(bad == 0.0)) {
      memcpy(m, held, RS_SIZE * sizeof(double));
      return n;
    }
    int wants = 0;
    for (int64_t k = 0; k < n_callbacks; ++k) wants |= (callback[k].said = callback[k].function(callback[k].context)) != 0;
    if (wants) return n + 1;
    if (n % every == 0) rows += RS_NY;
  }
  return n1;
}
#endif
