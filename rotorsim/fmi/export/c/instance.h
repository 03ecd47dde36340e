/* What FMI 2 and FMI 3 have in common: one instance of a model, its phases, its variables, its steps.
 *
 * It follows the generated model (model.inc) in one translation unit. Nothing is static but constant tables, so any
 * number of instances live side by side. Everything that a saved state holds is in d, a block of doubles:
 * head, parameters p, slopes of the inputs, and the memory m of the C runtime.
 *
 * Scalars are numbered 0 (time), parameters, inputs, outputs, states, derivatives, discrete states, events; the number
 * is the value reference, and an array has that of its first entry.
 */
#include <float.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

enum { RF_OK, RF_WARNING, RF_DISCARD, RF_ERROR, RF_FATAL };
enum { /* phases: one bit each, so that a function can name the ones that allow it */
  RF_INSTANTIATED = 1,
  RF_INITIALISING = 2,
  RF_EVENT = 4,
  RF_CONTINUOUS = 8,
  RF_STEPPING = 16,
  RF_TERMINATED = 32,
  RF_FAILED = 64,
  RF_ANY = 127
};
enum { /* what must be computed again before it is read: one bit each */
  RF_STALE_INITIAL = 1,
  RF_STALE_P = 2,
  RF_STALE_G = 4,
  RF_STALE_EXTRA = 8,
  RF_STALE_Y = 16,
  RF_STALE_RATE = 32,
  RF_STALE_EVENT = 64,
  RF_STALE_VALUES = RF_STALE_Y | RF_STALE_RATE | RF_STALE_EVENT,
  RF_STALE_ALL = 127
};
enum { RF_LOG_ERRORS = 1, RF_LOG_WARNINGS = 2, RF_LOG_EVENTS = 4 };

#define RF_AT_TIME 0
#define RF_AT_PARAMETER 1
#define RF_AT_INPUT (RF_AT_PARAMETER + RF_NA)
#define RF_AT_OUTPUT (RF_AT_INPUT + RF_NU)
#define RF_AT_STATE (RF_AT_OUTPUT + RF_NY)
#define RF_AT_DERIVATIVE (RF_AT_STATE + RS_NX)
#define RF_AT_DISCRETE (RF_AT_DERIVATIVE + RS_NX)
#define RF_AT_EVENT (RF_AT_DISCRETE + RF_NZ)
#define RF_COUNT (RF_AT_EVENT + RF_NE)

/* places in d */
#define RF_MAGIC 0
#define RF_KIND 1
#define RF_PHASE 2
#define RF_TIME 3   /* now */
#define RF_ANCHOR 4 /* now = anchor + step * RF_STEP while steps follow the grid */
#define RF_STEPS 5
#define RF_STOP 6 /* stop time, infinity when there is none */
#define RF_STALE 7
#define RF_START 8
#define RF_HEAD 9
#define RF_AT_P RF_HEAD
#define RF_AT_SLOPE (RF_AT_P + RF_NP)
#define RF_AT_M (RF_AT_SLOPE + RF_NU)
#define RF_TOTAL (RF_AT_M + RS_SIZE)

typedef struct rf_instance {
  double d[RF_TOTAL]; /* in front: nested.h finds the instance by p */
  double y[RS_NY + 1], rate[RS_NX + 1], event[RF_NE + 1], row[RS_NY + 1];
  double extra[RF_NC + 1], seed[RF_N_KNOWN + RF_NP + 1], result[RF_N_UNKNOWN + RS_NX + 1];
  double begun[RS_NX + RS_NZ + 1], more[RF_N_UNKNOWN + RF_NP + 1], work[RF_WORK + 1];
  int log, status, ended; /* status: of what was computed for the function at work; ended: the end was asked for */
#if RF_NESTED
  double held[RF_TOTAL];
  rf_switching at;
  rs_function calls[RF_CALLED];
  rf_inner inner[RF_NESTED];
#endif
  void *environment;
  void (*callback)(void);
  char *name;
} rf_instance;

/* Hand a message to the importer; defined by the version. */
static void rf_deliver(rf_instance *i, int status, const char *category, const char *text);

static int rf_log(rf_instance *i, int status, const char *format, ...) {
  static const char *const categories[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError",
                                           "logStatusFatal"};
  const int wanted = status == RF_OK ? RF_LOG_EVENTS : status == RF_WARNING ? RF_LOG_WARNINGS : RF_LOG_ERRORS;
  if (i->callback && (i->log & wanted)) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    rf_deliver(i, status, categories[status], text);
  }
  return status;
}

static const char *rf_phase_name(int phase) {
  switch (phase) {
    case RF_INSTANTIATED: return "instantiated";
    case RF_INITIALISING: return "initialization mode";
    case RF_EVENT: return "event mode";
    case RF_CONTINUOUS: return "continuous-time mode";
    case RF_STEPPING: return "step mode";
    case RF_TERMINATED: return "terminated";
    default: return "after an error";
  }
}

static int rf_allow(rf_instance *i, const char *function, int phases) {
  const int phase = (int)i->d[RF_PHASE];
  if (phase & phases) return RF_OK;
  return rf_log(i, RF_ERROR, "%s is not allowed now (%s)", function, rf_phase_name(phase));
}

static double *rf_p(rf_instance *i) { return i->d + RF_AT_P; }
static double *rf_m(rf_instance *i) { return i->d + RF_AT_M; }
static double *rf_x(rf_instance *i) { return rf_m(i) + RS_AT_X; }
static double *rf_z(rf_instance *i) { return rf_m(i) + RS_AT_Z; }
static int rf_stale(const rf_instance *i, int what) { return ((int)i->d[RF_STALE] & what) != 0; }
static void rf_soil(rf_instance *i, int what) { i->d[RF_STALE] = (int)i->d[RF_STALE] | what; }
static void rf_clean(rf_instance *i, int what) { i->d[RF_STALE] = (int)i->d[RF_STALE] & ~what; }

/* Return the status of what was computed, for the importer, and forget it. */
static int rf_outcome(rf_instance *i) {
  const int status = i->status;
  i->status = RF_OK;
  if (status >= RF_ERROR) i->d[RF_PHASE] = RF_FAILED;
  if (status >= RF_DISCARD) rf_soil(i, RF_STALE_G | RF_STALE_VALUES);
  return status;
}

#if RF_NESTED
static int rf_look(rf_instance *i, double *z);
#include "nested.h"
#endif

/* Bring initial states, constants and the forcing of this instant up to date. */
static void rf_refresh(rf_instance *i) {
  double *p = rf_p(i), *m = rf_m(i);
  if (rf_stale(i, RF_STALE_INITIAL)) rf_initial(p, rf_x(i), rf_z(i), i->work);
  if (rf_stale(i, RF_STALE_P)) rs_prepare(p, m);
  if (rf_stale(i, RF_STALE_G)) rs_forcing(i->d[RF_TIME], p, m + RS_AT_C, m + RS_AT_G, m + RS_AT_WORK);
  rf_clean(i, RF_STALE_INITIAL | RF_STALE_P | RF_STALE_G);
}

static void rf_refresh_extra(rf_instance *i) {
  rf_refresh(i);
  if (rf_stale(i, RF_STALE_EXTRA)) rf_constants(rf_p(i), i->extra, i->work);
  rf_clean(i, RF_STALE_EXTRA);
}

static void rf_outputs(rf_instance *i) {
  double *m = rf_m(i);
  rf_refresh(i);
  if (!rf_stale(i, RF_STALE_Y)) return;
  rs_outputs(rf_x(i), rf_z(i), rf_p(i), m + RS_AT_C, m + RS_AT_G, i->y, m + RS_AT_WORK);
  rf_clean(i, RF_STALE_Y);
  for (int k = RF_NY; k < RS_NY; ++k)
    if (!(fabs(i->y[k]) <= RF_LOOP_TOLERANCE)) {
      rf_log(i, RF_WARNING, "an algebraic loop is not solved at t = %.9g s: residual %.3g", i->d[RF_TIME], i->y[k]);
      break;
    }
}

static void rf_rates(rf_instance *i) {
  double *m = rf_m(i);
  rf_refresh(i);
  if (!rf_stale(i, RF_STALE_RATE)) return;
  rs_rhs(rf_x(i), rf_z(i), rf_p(i), m + RS_AT_C, m + RS_AT_G, i->rate, m + RS_AT_WORK);
  rf_clean(i, RF_STALE_RATE);
}

static void rf_indicators(rf_instance *i) {
  rf_refresh_extra(i);
  if (!rf_stale(i, RF_STALE_EVENT)) return;
  rf_event(i->d[RF_TIME], rf_x(i), rf_z(i), rf_p(i), i->extra, i->event, i->work);
#if RF_NESTED
  rf_look(i, i->event + RF_NE - RF_NESTED_Z);
#endif
  rf_clean(i, RF_STALE_EVENT);
}

/* ---- creation ---- */

static void rf_begin(rf_instance *i, int kind) {
  double *d = i->d;
  memset(d, 0, RF_TOTAL * sizeof(double));
  memcpy(d + RF_AT_P, rf_p0, RF_NP * sizeof(double));
  for (int k = 0; k < RS_NX; ++k) rf_x(i)[k] = rf_x0[k];
  for (int k = 0; k < RF_NZ; ++k) rf_z(i)[k] = rf_z0[k];
  d[RF_MAGIC] = RF_MAGIC_NUMBER;
  d[RF_KIND] = kind;
  d[RF_PHASE] = RF_INSTANTIATED;
  d[RF_STOP] = HUGE_VAL;
  rf_soil(i, RF_STALE_ALL);
#if RF_NESTED
  rf_restart_inners(i);
#endif
}

/* resources: their location, a file URI or a path. */
static rf_instance *rf_create(const char *name, const char *token, const char *resources, int kind, int log,
                              void *environment, void (*callback)(void)) {
  rf_instance *i = (rf_instance *)calloc(1, sizeof *i);
  const size_t length = name ? strlen(name) : 0;
  if (!i) return 0;
  i->log = RF_LOG_ERRORS | RF_LOG_WARNINGS | (log ? RF_LOG_EVENTS : 0);
  i->environment = environment;
  i->callback = callback;
  i->name = (char *)calloc(length + 1, 1);
  if (i->name && length) memcpy(i->name, name, length);
  if (!i->name || !length) {
    rf_log(i, RF_ERROR, "the instance has no name");
  } else if (!token || strcmp(token, RF_TOKEN) != 0) {
    rf_log(i, RF_ERROR, "the GUID or token %s is not that of this FMU, " RF_TOKEN, token ? token : "(none)");
  } else {
    rf_begin(i, kind);
#if RF_NESTED
    if (!rf_create_inners(i, resources)) return i;
#else
    (void)resources;
    return i;
#endif
  }
  free(i->name), free(i);
  return 0;
}

static void rf_destroy(rf_instance *i) {
#if RF_NESTED
  if (i) rf_destroy_inners(i);
#endif
  if (i) free(i->name), free(i);
}

/* ---- variables ---- */

static int rf_known(rf_instance *i, const char *function, unsigned k) {
  if (k < RF_COUNT && rf_width[k]) return RF_OK;
  return rf_log(i, RF_ERROR, "%s: there is no variable with value reference %u", function, k);
}

/* Return the value of scalar k, which exists. */
static double rf_value(rf_instance *i, unsigned k) {
  if (k >= RF_AT_EVENT) return rf_indicators(i), i->event[k - RF_AT_EVENT];
  if (k >= RF_AT_DISCRETE) return rf_refresh(i), rf_z(i)[k - RF_AT_DISCRETE];
  if (k >= RF_AT_DERIVATIVE) return rf_rates(i), i->rate[k - RF_AT_DERIVATIVE];
  if (k >= RF_AT_STATE) return rf_refresh(i), rf_x(i)[k - RF_AT_STATE];
  if (k >= RF_AT_OUTPUT) return rf_outputs(i), i->y[k - RF_AT_OUTPUT];
  if (k >= RF_AT_INPUT) return rf_z(i)[RF_NZ + (k - RF_AT_INPUT)];
  if (k >= RF_AT_PARAMETER) return rf_p(i)[rf_follow[rf_follow_at[k - RF_AT_PARAMETER]]];
  return i->d[RF_TIME];
}

static int rf_set_parameter(rf_instance *i, unsigned k, double value) {
  const unsigned a = k - RF_AT_PARAMETER;
  const int early = ((int)i->d[RF_PHASE] & (RF_INSTANTIATED | RF_INITIALISING)) != 0;
  if (rf_fixed[a] && !early)
    return rf_log(i, RF_ERROR, "%s is fixed: it can be set only until the initialization ends", rf_name[k]);
  if (!(value >= rf_low[a] && value <= rf_high[a]) || (rf_open[a] && value == rf_low[a]))
    return rf_log(i, RF_ERROR, "%s = %.9g is outside its range, %s %.9g to %.9g", rf_name[k], value,
                  rf_open[a] ? "above" : "from", rf_low[a], rf_high[a]);
  for (int j = rf_follow_at[a]; j < rf_follow_at[a + 1]; ++j) rf_p(i)[rf_follow[j]] = value;
  rf_soil(i, early ? RF_STALE_ALL : RF_STALE_ALL & ~RF_STALE_INITIAL);
  return RF_OK;
}

/* Set scalar k, which exists. */
static int rf_assign(rf_instance *i, unsigned k, double value) {
  const int phase = (int)i->d[RF_PHASE];
  const int early = (phase & (RF_INSTANTIATED | RF_INITIALISING)) != 0;
  if (!(value - value == 0.0)) return rf_log(i, RF_ERROR, "%s: %g is not a finite number", rf_name[k], value);
  if (k >= RF_AT_PARAMETER && k < RF_AT_INPUT) return rf_set_parameter(i, k, value);
  if (k >= RF_AT_INPUT && k < RF_AT_OUTPUT) {
    rf_z(i)[RF_NZ + (k - RF_AT_INPUT)] = value;
  } else if (k >= RF_AT_STATE && k < RF_AT_DERIVATIVE &&
             ((early && rf_x_exact[k - RF_AT_STATE]) || (phase & (RF_EVENT | RF_CONTINUOUS)))) {
    rf_x(i)[k - RF_AT_STATE] = value;
  } else if (k >= RF_AT_DISCRETE && k < RF_AT_EVENT && early && rf_z_exact[k - RF_AT_DISCRETE]) {
    rf_z(i)[k - RF_AT_DISCRETE] = value;
  } else {
    return rf_log(i, RF_ERROR, "%s cannot be set now (%s)", rf_name[k], rf_phase_name(phase));
  }
  rf_soil(i, RF_STALE_VALUES);
  return RF_OK;
}

/* Get or set n variables, arrays entry by entry; n_values: number of entries, or -1 when it is not told. */
static int rf_get(rf_instance *i, const char *function, const unsigned *references, size_t n, double *values,
                  long long n_values) {
  long long at = 0;
  for (size_t j = 0; j < n; ++j) {
    if (rf_known(i, function, references[j])) return RF_ERROR;
    for (unsigned k = 0; k < rf_width[references[j]]; ++k) {
      if (n_values >= 0 && at >= n_values) return rf_log(i, RF_ERROR, "%s: too few values", function);
      values[at++] = rf_value(i, references[j] + k);
    }
  }
  if (n_values >= 0 && at != n_values) return rf_log(i, RF_ERROR, "%s: too many values", function);
  return rf_outcome(i);
}

static int rf_set(rf_instance *i, const char *function, const unsigned *references, size_t n, const double *values,
                  long long n_values) {
  long long at = 0;
  if (rf_allow(i, function, RF_ANY & ~(RF_TERMINATED | RF_FAILED))) return RF_ERROR;
  for (size_t j = 0; j < n; ++j) {
    if (rf_known(i, function, references[j])) return RF_ERROR;
    for (unsigned k = 0; k < rf_width[references[j]]; ++k) {
      if (n_values >= 0 && at >= n_values) return rf_log(i, RF_ERROR, "%s: too few values", function);
      if (rf_assign(i, references[j] + k, values[at++])) return RF_ERROR;
    }
  }
  if (n_values >= 0 && at != n_values) return rf_log(i, RF_ERROR, "%s: too many values", function);
  return RF_OK;
}

/* Set a vector of states; not finite: the solver is told to try a smaller step. */
static int rf_set_states(rf_instance *i, const double *x, size_t n) {
  if (n != RS_NX) return rf_log(i, RF_ERROR, "%d states expected, %d given", RS_NX, (int)n);
  for (int k = 0; k < RS_NX; ++k)
    if (!(x[k] - x[k] == 0.0)) return RF_DISCARD;
  for (int k = 0; k < RS_NX; ++k) rf_x(i)[k] = x[k];
  rf_soil(i, RF_STALE_VALUES);
  return RF_OK;
}

static void rf_set_time(rf_instance *i, double t) {
  if (t != i->d[RF_TIME]) rf_soil(i, RF_STALE_G | RF_STALE_VALUES);
  i->d[RF_TIME] = t;
}
