/* FMI 3.0, model exchange and co-simulation, over instance.h. Compile this file alone:
 *   cc -std=c99 -O3 -fPIC -shared -ffp-contract=off fmi3.c -o <modelIdentifier>.so -lm
 * Types and signatures are those of the FMI 3.0.2 standard.
 */
#include "model.inc"

#include "instance.h"

#include "derivatives.h"

#include "stepping.h"

#include <stdbool.h>

typedef void *fmi3Instance;
typedef uint32_t fmi3ValueReference;
typedef double fmi3Float64;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef int fmi3Status; /* OK, Warning, Discard, Error, Fatal: 0 to 4, as RF_OK ... */
typedef void (*fmi3LogMessageCallback)(void *, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3Callback)(void);

static void rf_deliver(rf_instance *i, int status, const char *category, const char *text) {
  ((fmi3LogMessageCallback)i->callback)(i->environment, status, category, text);
}

#define RF_FMI fmi3
#if defined(FMI3_FUNCTION_PREFIX)
#define RF_PREFIX FMI3_FUNCTION_PREFIX
#endif
#define RF_BOOLEAN fmi3Boolean
#define RF_BYTE fmi3Byte
#define RF_STATE FMUState
#define RF_DESERIALIZE DeserializeFMUState
#define RF_DERIVATIVES GetContinuousStateDerivatives
#include "functions.h"

RF_EXPORT const char *FMI(GetVersion)(void) { return "3.0"; }

RF_EXPORT fmi3Instance FMI(InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean log, void *environment,
                                                     fmi3LogMessageCallback message) {
  (void)visible;
  return rf_create(name, token, resources, 0, log, environment, (fmi3Callback)message);
}

RF_EXPORT fmi3Instance FMI(InstantiateCoSimulation)(fmi3String name, fmi3String token, fmi3String resources,
                                                    fmi3Boolean visible, fmi3Boolean log, fmi3Boolean event_mode,
                                                    fmi3Boolean early_return, const fmi3ValueReference required[],
                                                    size_t n_required, void *environment,
                                                    fmi3LogMessageCallback message, fmi3Callback intermediate) {
  (void)visible, (void)early_return, (void)required, (void)n_required, (void)intermediate;
  if (event_mode) {
    if (message) message(environment, RF_ERROR, "logStatusError", "this FMU has no event mode in co-simulation");
    return 0;
  }
  return rf_create(name, token, resources, 1, log, environment, (fmi3Callback)message);
}

RF_EXPORT fmi3Instance FMI(InstantiateScheduledExecution)(fmi3String name, fmi3String token, fmi3String resources,
                                                          fmi3Boolean visible, fmi3Boolean log, void *environment,
                                                          fmi3LogMessageCallback message, fmi3Callback update,
                                                          fmi3Callback lock, fmi3Callback unlock) {
  (void)name, (void)token, (void)resources, (void)visible, (void)log, (void)update, (void)lock, (void)unlock;
  if (message) message(environment, RF_ERROR, "logStatusError", "this FMU is not for scheduled execution");
  return 0;
}

RF_EXPORT fmi3Status FMI(EnterInitializationMode)(fmi3Instance c, fmi3Boolean tolerance_defined,
                                                  fmi3Float64 tolerance, fmi3Float64 start,
                                                  fmi3Boolean stop_defined, fmi3Float64 stop) {
  (void)tolerance_defined, (void)tolerance;
  ALLOW(RF_INSTANTIATED);
  return rf_enter_initialisation(i, start, stop_defined ? stop : HUGE_VAL);
}

/* ---- variables: all are Float64 ---- */

RF_EXPORT fmi3Status FMI(GetFloat64)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[],
                                     size_t n_values) {
  INSTANCE;
  return rf_get(i, __func__, vr, n, values, (long long)n_values);
}

RF_EXPORT fmi3Status FMI(SetFloat64)(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                     const fmi3Float64 values[], size_t n_values) {
  INSTANCE;
  return rf_set(i, __func__, vr, n, values, (long long)n_values);
}

#define NONE_OF(kind, type)                                                                                         \
  RF_EXPORT fmi3Status FMI(Get##kind)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type values[],       \
                                         size_t n_values) {                                                         \
    INSTANCE;                                                                                                       \
    (void)vr, (void)values, (void)n_values;                                                                         \
    return n == 0 ? RF_OK : rf_log(i, RF_ERROR, "%s: all variables of this FMU are Float64", __func__);             \
  }                                                                                                                 \
  RF_EXPORT fmi3Status FMI(Set##kind)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const type values[], \
                                         size_t n_values) {                                                         \
    INSTANCE;                                                                                                       \
    (void)vr, (void)values, (void)n_values;                                                                         \
    return n == 0 ? RF_OK : rf_log(i, RF_ERROR, "%s: all variables of this FMU are Float64", __func__);             \
  }
NONE_OF(Float32, float)
NONE_OF(Int8, int8_t)
NONE_OF(UInt8, uint8_t)
NONE_OF(Int16, int16_t)
NONE_OF(UInt16, uint16_t)
NONE_OF(Int32, int32_t)
NONE_OF(UInt32, uint32_t)
NONE_OF(Int64, int64_t)
NONE_OF(UInt64, uint64_t)
NONE_OF(Boolean, fmi3Boolean)
NONE_OF(String, fmi3String)

#define NO_VARIABLES(name, arguments, unused)                                                    \
  RF_EXPORT fmi3Status FMI(name) arguments {                                                     \
    INSTANCE;                                                                                    \
    unused;                                                                                      \
    return n == 0 ? RF_OK : rf_log(i, RF_ERROR, "%s: this FMU has no such variables", __func__); \
  }
#define REFERENCES fmi3Instance c, const fmi3ValueReference vr[], size_t n
NO_VARIABLES(GetBinary, (REFERENCES, size_t sizes[], const fmi3Byte *values[], size_t n_values),
             ((void)vr, (void)sizes, (void)values, (void)n_values))
NO_VARIABLES(SetBinary, (REFERENCES, const size_t sizes[], const fmi3Byte *const values[], size_t n_values),
             ((void)vr, (void)sizes, (void)values, (void)n_values))
NO_VARIABLES(GetClock, (REFERENCES, bool values[]), ((void)vr, (void)values))
NO_VARIABLES(SetClock, (REFERENCES, const bool values[]), ((void)vr, (void)values))
NO_VARIABLES(GetIntervalDecimal, (REFERENCES, double values[], int qualifiers[]),
             ((void)vr, (void)values, (void)qualifiers))
NO_VARIABLES(GetIntervalFraction, (REFERENCES, uint64_t counters[], uint64_t resolutions[], int qualifiers[]),
             ((void)vr, (void)counters, (void)resolutions, (void)qualifiers))
NO_VARIABLES(GetShiftDecimal, (REFERENCES, double values[]), ((void)vr, (void)values))
NO_VARIABLES(GetShiftFraction, (REFERENCES, uint64_t counters[], uint64_t resolutions[]),
             ((void)vr, (void)counters, (void)resolutions))
NO_VARIABLES(SetIntervalDecimal, (REFERENCES, const double values[]), ((void)vr, (void)values))
NO_VARIABLES(SetIntervalFraction, (REFERENCES, const uint64_t counters[], const uint64_t resolutions[]),
             ((void)vr, (void)counters, (void)resolutions))
NO_VARIABLES(SetShiftDecimal, (REFERENCES, const double values[]), ((void)vr, (void)values))
NO_VARIABLES(SetShiftFraction, (REFERENCES, const uint64_t counters[], const uint64_t resolutions[]),
             ((void)vr, (void)counters, (void)resolutions))

#define NOT_OFFERED(name, arguments, unused)                                  \
  RF_EXPORT fmi3Status FMI(name) arguments {                                  \
    INSTANCE;                                                                 \
    unused;                                                                   \
    return rf_log(i, RF_ERROR, "%s: this FMU does not offer this", __func__); \
  }
NOT_OFFERED(GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference vr, size_t *n), ((void)vr, (void)n))
NOT_OFFERED(GetVariableDependencies,
            (fmi3Instance c, fmi3ValueReference dependent, size_t at[], fmi3ValueReference independents[],
             size_t elements[], int kinds[], size_t n),
            ((void)dependent, (void)at, (void)independents, (void)elements, (void)kinds, (void)n))
NOT_OFFERED(EnterConfigurationMode, (fmi3Instance c), ((void)0))
NOT_OFFERED(ExitConfigurationMode, (fmi3Instance c), ((void)0))
NOT_OFFERED(EnterStepMode, (fmi3Instance c), ((void)0))
NOT_OFFERED(ActivateModelPartition, (fmi3Instance c, fmi3ValueReference clock, double time), ((void)clock, (void)time))

/* ---- derivatives ---- */

RF_EXPORT fmi3Status FMI(GetDirectionalDerivative)(fmi3Instance c, const fmi3ValueReference unknowns[],
                                                   size_t n_unknowns, const fmi3ValueReference knowns[],
                                                   size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                                   fmi3Float64 result[], size_t n_result) {
  INSTANCE;
  return rf_directional(i, __func__, unknowns, n_unknowns, knowns, n_knowns, seed, (long long)n_seed, result,
                        (long long)n_result, 1);
}

RF_EXPORT fmi3Status FMI(GetAdjointDerivative)(fmi3Instance c, const fmi3ValueReference unknowns[],
                                               size_t n_unknowns, const fmi3ValueReference knowns[],
                                               size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
                                               fmi3Float64 result[], size_t n_result) {
  INSTANCE;
  return rf_directional(i, __func__, unknowns, n_unknowns, knowns, n_knowns, seed, (long long)n_seed, result,
                        (long long)n_result, 0);
}

/* ---- events ---- */

RF_EXPORT fmi3Status FMI(EvaluateDiscreteStates)(fmi3Instance c) {
  ALLOW(RF_INITIALISING | RF_EVENT);
  return RF_OK;
}

RF_EXPORT fmi3Status FMI(UpdateDiscreteStates)(fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *terminate,
                                               fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *next_defined,
                                               fmi3Float64 *next_time) {
  ALLOW(RF_EVENT);
  const double next = rf_update(i);
  *needed = false;
  *terminate = i->ended;
  *values = rf_changed(i, 0);
  *nominals = rf_changed(i, 1);
  *next_defined = next < HUGE_VAL;
  *next_time = next < HUGE_VAL ? next : 0.0;
  return rf_outcome(i);
}

/* ---- model exchange ---- */

RF_EXPORT fmi3Status FMI(GetNumberOfEventIndicators)(fmi3Instance c, size_t *n) {
  INSTANCE;
  return *n = RF_NE, RF_OK;
}

RF_EXPORT fmi3Status FMI(GetNumberOfContinuousStates)(fmi3Instance c, size_t *n) {
  INSTANCE;
  return *n = RS_NX, RF_OK;
}

/* ---- co-simulation ---- */

RF_EXPORT fmi3Status FMI(GetOutputDerivatives)(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                               const int32_t orders[], fmi3Float64 values[], size_t n_values) {
  ALLOW(RF_STEPPING | RF_TERMINATED);
  return rf_output_rates(i, __func__, vr, n, orders, values, (long long)n_values);
}

RF_EXPORT fmi3Status FMI(DoStep)(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_set_state,
                                 fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                                 fmi3Float64 *last_time) {
  INSTANCE;
  (void)no_set_state;
  const int status = rf_step(i, __func__, time, size);
  *event_needed = *early_return = false;
  *terminate = i->ended;
  *last_time = i->d[RF_TIME];
  return i->ended && status == RF_DISCARD ? RF_OK : status;
}
