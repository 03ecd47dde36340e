/* Phases, sample hits, steps of co-simulation, saved states: the second half of instance.h. */
#if RF_NESTED
#include "switching.h"
#endif

/* ---- phases ---- */

static int rf_enter_initialisation(rf_instance *i, double start, double stop) {
  if (!(start - start == 0.0)) return rf_log(i, RF_ERROR, "the start time %g is not finite", start);
  i->d[RF_TIME] = i->d[RF_ANCHOR] = i->d[RF_START] = start;
  i->d[RF_STEPS] = 0;
  i->d[RF_STOP] = stop;
  i->d[RF_PHASE] = RF_INITIALISING;
  rf_soil(i, RF_STALE_ALL);
#if RF_NESTED
  rf_restart_inners(i);
#endif
  return RF_OK;
}

static int rf_exit_initialisation(rf_instance *i) {
  rf_refresh(i);
#if RS_NS > 0
  if (i->d[RF_KIND] == 0) { /* model exchange: the hits due now are those of the first event */
    for (int s = 0; s < RS_NS; ++s)
      rf_m(i)[RS_AT_COUNT + s] = ceil(i->d[RF_TIME] / rf_p(i)[rs_period[s]] - 1e-9);
  } else {
    rs_start(i->d[RF_TIME], rf_p(i), rf_m(i));
  }
#endif
  i->d[RF_PHASE] = i->d[RF_KIND] == 0 ? RF_EVENT : RF_STEPPING;
  rf_soil(i, RF_STALE_VALUES);
#if RF_NESTED
  if (i->d[RF_KIND] != 0 && i->status < RF_DISCARD) rf_begin_switching(i);
#endif
  return rf_outcome(i);
}

/* Carry out the sample hits and events due now; return the time of the next one, infinity if there is none. */
static double rf_update(rf_instance *i) {
  double next = HUGE_VAL;
#if RS_NS > 0
  double *p = rf_p(i), *m = rf_m(i), now = i->d[RF_TIME];
  next = rs_next_hit(p, m);
  rf_refresh(i);
  if (next <= now + 1e-12 * (1.0 + fabs(now))) { /* solvers arrive at an event but for rounding */
    if (next > now) now = next;
    rs_sample(now, p, m);
    rf_log(i, RF_OK, "sample hit at t = %.9g s", now);
    rf_soil(i, RF_STALE_G | RF_STALE_VALUES);
    next = rs_next_hit(p, m);
  }
#endif
#if RF_NESTED
  rf_update_inners(i);
  if (rf_next_event(i) < next) next = rf_next_event(i);
#endif
  (void)i;
  return next;
}

/* Return whether the last event has changed states, or their nominal values: those of FMUs inside alone. */
static int rf_changed(const rf_instance *i, int nominals) {
#if RF_NESTED
  for (int k = 0; k < RF_NESTED; ++k)
    if (nominals ? i->inner[k].nominals : i->inner[k].states) return 1;
#endif
  (void)i, (void)nominals;
  return 0;
}

/* ---- co-simulation ---- */

static int rf_finite(rf_instance *i) {
  const double *x = rf_x(i);
  int worst = 0;
  if (rs_bounded(x)) return RF_OK;
  for (int k = 1; k < RS_NX && x[worst] == x[worst]; ++k)
    if (!(fabs(x[k]) <= fabs(x[worst]))) worst = k;
  i->d[RF_PHASE] = RF_FAILED;
  return rf_log(i, RF_ERROR,
                "%s grows without bound, at t = %.9g s it is %.3g: the motion diverges, or the step %g s is too large",
                rf_name[RF_AT_STATE + worst], i->d[RF_TIME], x[worst], RF_STEP);
}

/* Take steps n0..n1-1 of size h from t0; inputs with a slope follow it, at the middle of every step. Return the step
 * reached: less than n1 when a state is not finite. */
static int64_t rf_march(rf_instance *i, int64_t n0, int64_t n1, double t0, double h) {
  double *slope = i->d + RF_AT_SLOPE, *u = rf_z(i) + RF_NZ;
#if !RF_NESTED
  const int64_t never = INT64_MAX;
  int moving = 0;
  for (int k = 0; k < RF_NU; ++k) moving |= slope[k] != 0.0;
  if (!moving) return rs_run(rf_p(i), rf_m(i), n0, n1, t0, h, never, i->row);
#endif
  for (int64_t n = n0; n < n1; ++n) {
    for (int k = 0; k < RF_NU; ++k) u[k] += 0.5 * h * slope[k];
#if RF_NESTED
    if (rf_step_over(i, n, t0, h)) return n;
#else
    rs_run(rf_p(i), rf_m(i), n, n + 1, t0, h, never, i->row);
#endif
    for (int k = 0; k < RF_NU; ++k) u[k] += 0.5 * h * slope[k];
  }
  for (int k = 0; k < RF_NU; ++k) slope[k] = 0.0;
  return n1;
}

/* Step from time `at` by `size`: on the model's own grid where size is a multiple of RF_STEP. */
static int rf_step(rf_instance *i, const char *function, double at, double size) {
  double *d = i->d;
  const double h = RF_STEP, rounding = 4.0 * DBL_EPSILON * (fabs(d[RF_TIME]) + fabs(size));
  if (rf_allow(i, function, RF_STEPPING)) return RF_ERROR;
  if (!(size >= 0.0) || !(size - size == 0.0) || !(fabs(at - d[RF_TIME]) <= 1e-3 * h + rounding))
    return rf_log(i, RF_ERROR, "%s: a step of %.9g s from t = %.9g s does not follow on t = %.9g s", function, size, at,
                  d[RF_TIME]);
  if (at + size > d[RF_STOP] + 1e-3 * h + rounding)
    return rf_log(i, RF_ERROR, "%s: t = %.9g s is behind the stop time %.9g s", function, at + size, d[RF_STOP]);
  if (fabs(at - d[RF_TIME]) > 1e-6 * h + rounding) { /* the clock of the importer counts */
    d[RF_TIME] = d[RF_ANCHOR] = at;
    d[RF_STEPS] = 0;
    rf_soil(i, RF_STALE_G);
  }
  if (i->ended) return RF_DISCARD;
  rf_refresh(i);
  const double from = d[RF_TIME], count = floor(size / h + 0.5);
  if (fabs(count * h - size) <= 1e-9 * size + rounding) {
    const int64_t n = (int64_t)d[RF_STEPS];
    d[RF_STEPS] = (double)rf_march(i, n, n + (int64_t)count, d[RF_ANCHOR], h);
    if (!i->ended) d[RF_TIME] = d[RF_ANCHOR] + d[RF_STEPS] * h;
  } else {
    const double parts = ceil(size / h * (1.0 - 1e-9));
    rf_march(i, 0, (int64_t)parts, from, size / parts);
    if (!i->ended) d[RF_TIME] = d[RF_ANCHOR] = from + size;
    d[RF_STEPS] = 0;
    rf_soil(i, RF_STALE_G);
  }
  rf_soil(i, RF_STALE_VALUES);
  if (i->status >= RF_DISCARD) { /* what could be computed again with a smaller step: there is none here */
    i->status = RF_ERROR;
    return rf_outcome(i);
  }
  return i->ended ? RF_DISCARD : rf_finite(i);
}

/* ---- saved states ---- */

#if RF_NESTED
#include "saved.h"
#else
static int rf_restore(rf_instance *i, const char *function, const void *state) {
  const double *saved = (const double *)state;
  if (!saved || saved[RF_MAGIC] != RF_MAGIC_NUMBER || saved[RF_KIND] != i->d[RF_KIND])
    return rf_log(i, RF_ERROR, "%s: this is not a state of this FMU", function);
  memcpy(i->d, saved, sizeof i->d);
  rf_soil(i, RF_STALE_EXTRA | RF_STALE_VALUES);
  return RF_OK;
}

static int rf_save(rf_instance *i, void **state) {
  if (!*state) *state = malloc(sizeof i->d);
  if (!*state) return rf_log(i, RF_ERROR, "not enough memory for a state of %d bytes", (int)sizeof i->d);
  memcpy(*state, i->d, sizeof i->d);
  return RF_OK;
}

static void rf_free_saved(rf_instance *i, void *state) {
  (void)i;
  free(state);
}

static size_t rf_serialised(const rf_instance *i) { return sizeof i->d; }

static int rf_serialise(rf_instance *i, const char *function, const void *state, void *bytes, size_t size) {
  if (!state || size < sizeof i->d) return rf_log(i, RF_ERROR, "%s: no state, or too few bytes", function);
  memcpy(bytes, state, sizeof i->d);
  return RF_OK;
}

static int rf_deserialise(rf_instance *i, const char *function, const void *bytes, size_t size, void **state) {
  if (size != sizeof i->d || memcmp(bytes, i->d, sizeof(double)) != 0)
    return rf_log(i, RF_ERROR, "%s: these bytes are not a state of this FMU", function);
  if (!*state) *state = malloc(size);
  if (!*state) return rf_log(i, RF_ERROR, "not enough memory for a state of %d bytes", (int)size);
  memcpy(*state, bytes, size);
  return RF_OK;
}
#endif

/* ---- what both versions offer in the same words ---- */

static int rf_set_logging(rf_instance *i, int on, size_t n, const char *const *names) {
  int log = 0;
  for (size_t k = 0; k < n; ++k) {
    const char *name = names[k] ? names[k] : "";
    if (!strcmp(name, "logAll")) log |= RF_LOG_ERRORS | RF_LOG_WARNINGS | RF_LOG_EVENTS;
    else if (!strcmp(name, "logStatusError")) log |= RF_LOG_ERRORS;
    else if (!strcmp(name, "logStatusWarning")) log |= RF_LOG_WARNINGS;
    else if (!strcmp(name, "logEvents")) log |= RF_LOG_EVENTS;
    else return rf_log(i, RF_ERROR, "there is no log category %s", name);
  }
  if (n == 0) log = RF_LOG_ERRORS | RF_LOG_WARNINGS | RF_LOG_EVENTS;
  i->log = on ? i->log | log : i->log & ~log;
  return RF_OK;
}

/* Give the slopes of inputs for the next step (co-simulation, FMI 2). */
static int rf_set_slopes(rf_instance *i, const char *function, const unsigned *references, size_t n, const int *order,
                         const double *value) {
  for (size_t j = 0; j < n; ++j) {
    const unsigned k = references[j];
    if (rf_known(i, function, k)) return RF_ERROR;
    if (k < RF_AT_INPUT || k >= RF_AT_OUTPUT) return rf_log(i, RF_ERROR, "%s: %s is no input", function, rf_name[k]);
    if (order[j] != 1) return rf_log(i, RF_ERROR, "%s: order %d of %s; only 1 is used", function, order[j], rf_name[k]);
    if (!(value[j] - value[j] == 0.0)) return rf_log(i, RF_ERROR, "%s: %s: not finite", function, rf_name[k]);
    i->d[RF_AT_SLOPE + (k - RF_AT_INPUT)] = value[j];
  }
  return RF_OK;
}

static int rf_get_states(rf_instance *i, double *x, size_t n) {
  if (n != RS_NX) return rf_log(i, RF_ERROR, "%d states expected, %d given", RS_NX, (int)n);
  rf_refresh(i);
  memcpy(x, rf_x(i), RS_NX * sizeof(double));
  return rf_outcome(i);
}

static int rf_get_rates(rf_instance *i, double *rate, size_t n) {
  if (n != RS_NX) return rf_log(i, RF_ERROR, "%d states expected, %d given", RS_NX, (int)n);
  rf_rates(i);
  memcpy(rate, i->rate, RS_NX * sizeof(double));
  return rf_outcome(i);
}

static int rf_get_indicators(rf_instance *i, double *event, size_t n) {
  if (n != RF_NE) return rf_log(i, RF_ERROR, "%d event indicators expected, %d given", RF_NE, (int)n);
  rf_indicators(i);
  memcpy(event, i->event, RF_NE * sizeof(double));
  return rf_outcome(i);
}

static int rf_get_nominals(rf_instance *i, double *nominal, size_t n) {
  if (n != RS_NX) return rf_log(i, RF_ERROR, "%d states expected, %d given", RS_NX, (int)n);
  memcpy(nominal, rf_nominal, RS_NX * sizeof(double));
  return RF_OK;
}
