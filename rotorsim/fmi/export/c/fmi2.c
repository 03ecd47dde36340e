/* FMI 2.0, model exchange and co-simulation, over instance.h. Compile this file alone:
 *   cc -std=c99 -O3 -fPIC -shared -ffp-contract=off fmi2.c -o <modelIdentifier>.so -lm
 * Types and signatures are those of the FMI 2.0.5 standard, platform "default".
 */
#include "model.inc"

#include "instance.h"

#include "derivatives.h"

#include "stepping.h"

#if defined(_WIN32)
#define FMI2_EXPORT __declspec(dllexport)
#else
#define FMI2_EXPORT __attribute__((visibility("default")))
#endif
#if defined(FMI2_FUNCTION_PREFIX) /* static linking only: FMI2_FUNCTION_PREFIX is <modelIdentifier>_ */
#define RF_JOIN(a, b) a##b
#define RF_PASTE(a, b) RF_JOIN(a, b)
#define FMI2(name) RF_PASTE(FMI2_FUNCTION_PREFIX, fmi2##name)
#else
#define FMI2(name) fmi2##name
#endif

typedef void *fmi2Component;
typedef void *fmi2FMUstate;
typedef unsigned fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef int fmi2Status; /* OK, Warning, Discard, Error, Fatal, Pending: 0 to 5, as RF_OK ... */
typedef int fmi2Type;   /* ModelExchange 0, CoSimulation 1 */
typedef struct {
  void (*logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(void *, fmi2Status);
  void *componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
  fmi2Boolean newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged,
      valuesOfContinuousStatesChanged, nextEventTimeDefined;
  fmi2Real nextEventTime;
} fmi2EventInfo;

static void rf_deliver(rf_instance *i, int status, const char *category, const char *text) {
  ((void (*)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...))i->callback)(i->environment, i->name, status,
                                                                                     category, text);
}

#define INSTANCE                     \
  rf_instance *i = (rf_instance *)c; \
  if (!i) return RF_ERROR
#define ALLOW(phases)                                                     \
  INSTANCE;                                                               \
  if (rf_allow(i, __func__, phases)) return RF_ERROR

FMI2_EXPORT const char *FMI2(GetTypesPlatform)(void) { return "default"; }
FMI2_EXPORT const char *FMI2(GetVersion)(void) { return "2.0"; }

FMI2_EXPORT fmi2Status FMI2(SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
  INSTANCE;
  return rf_set_logging(i, on, n, names);
}

FMI2_EXPORT fmi2Component FMI2(Instantiate)(fmi2String name, fmi2Type kind, fmi2String guid, fmi2String resources,
                                            const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                            fmi2Boolean log) {
  (void)resources, (void)visible;
  return rf_create(name, guid, kind, log, functions ? functions->componentEnvironment : 0,
                   functions ? (void (*)(void))functions->logger : 0);
}

FMI2_EXPORT void FMI2(FreeInstance)(fmi2Component c) { rf_destroy((rf_instance *)c); }

FMI2_EXPORT fmi2Status FMI2(SetupExperiment)(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                             fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
  (void)tolerance_defined, (void)tolerance;
  ALLOW(RF_INSTANTIATED);
  i->d[RF_START] = start;
  i->d[RF_STOP] = stop_defined ? stop : HUGE_VAL;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(EnterInitializationMode)(fmi2Component c) {
  ALLOW(RF_INSTANTIATED);
  return rf_enter_initialisation(i, i->d[RF_START], i->d[RF_STOP]);
}

FMI2_EXPORT fmi2Status FMI2(ExitInitializationMode)(fmi2Component c) {
  ALLOW(RF_INITIALISING);
  rf_exit_initialisation(i);
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(Terminate)(fmi2Component c) {
  ALLOW(RF_EVENT | RF_CONTINUOUS | RF_STEPPING);
  i->d[RF_PHASE] = RF_TERMINATED;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(Reset)(fmi2Component c) {
  INSTANCE;
  rf_begin(i, (int)i->d[RF_KIND]);
  return RF_OK;
}

/* ---- variables: all are Real ---- */

FMI2_EXPORT fmi2Status FMI2(GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  INSTANCE;
  return rf_get(i, __func__, vr, n, value, -1);
}

FMI2_EXPORT fmi2Status FMI2(SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  INSTANCE;
  return rf_set(i, __func__, vr, n, value, -1);
}

#define NONE_OF(kind, type, access)                                                                                  \
  FMI2_EXPORT fmi2Status FMI2(kind)(fmi2Component c, const fmi2ValueReference vr[], size_t n, access type value[]) { \
    INSTANCE;                                                                                                        \
    (void)vr, (void)value;                                                                                           \
    return n == 0 ? RF_OK : rf_log(i, RF_ERROR, "%s: all variables of this FMU are Real", __func__);                 \
  }
NONE_OF(GetInteger, fmi2Integer, )
NONE_OF(GetBoolean, fmi2Boolean, )
NONE_OF(GetString, fmi2String, )
NONE_OF(SetInteger, fmi2Integer, const)
NONE_OF(SetBoolean, fmi2Boolean, const)
NONE_OF(SetString, fmi2String, const)

/* ---- saved states ---- */

FMI2_EXPORT fmi2Status FMI2(GetFMUstate)(fmi2Component c, fmi2FMUstate *state) {
  INSTANCE;
  return rf_save(i, state);
}

FMI2_EXPORT fmi2Status FMI2(SetFMUstate)(fmi2Component c, fmi2FMUstate state) {
  INSTANCE;
  return rf_restore(i, __func__, (const double *)state);
}

FMI2_EXPORT fmi2Status FMI2(FreeFMUstate)(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  if (state) free(*state), *state = 0;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size) {
  INSTANCE;
  (void)state;
  *size = sizeof i->d;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  INSTANCE;
  if (!state || size < sizeof i->d) return rf_log(i, RF_ERROR, "%s: no state, or too few bytes", __func__);
  memcpy(bytes, state, sizeof i->d);
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                                 fmi2FMUstate *state) {
  INSTANCE;
  return rf_deserialise(i, __func__, bytes, size, state);
}

FMI2_EXPORT fmi2Status FMI2(GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknowns[],
                                                      size_t n_unknowns, const fmi2ValueReference knowns[],
                                                      size_t n_knowns, const fmi2Real seed[], fmi2Real result[]) {
  INSTANCE;
  return rf_directional(i, __func__, unknowns, n_unknowns, knowns, n_knowns, seed, -1, result, -1, 1);
}

/* ---- model exchange ---- */

FMI2_EXPORT fmi2Status FMI2(EnterEventMode)(fmi2Component c) {
  ALLOW(RF_EVENT | RF_CONTINUOUS);
  i->d[RF_PHASE] = RF_EVENT;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(NewDiscreteStates)(fmi2Component c, fmi2EventInfo *info) {
  ALLOW(RF_EVENT);
  const double next = rf_update(i);
  memset(info, 0, sizeof *info);
  info->nextEventTimeDefined = next < HUGE_VAL;
  info->nextEventTime = next < HUGE_VAL ? next : 0.0;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(EnterContinuousTimeMode)(fmi2Component c) {
  ALLOW(RF_EVENT);
  i->d[RF_PHASE] = RF_CONTINUOUS;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(CompletedIntegratorStep)(fmi2Component c, fmi2Boolean no_set_state,
                                                     fmi2Boolean *enter_event_mode, fmi2Boolean *terminate) {
  (void)no_set_state;
  ALLOW(RF_CONTINUOUS);
  *enter_event_mode = *terminate = 0;
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(SetTime)(fmi2Component c, fmi2Real time) {
  ALLOW(RF_EVENT | RF_CONTINUOUS);
  rf_set_time(i, time);
  return RF_OK;
}

FMI2_EXPORT fmi2Status FMI2(SetContinuousStates)(fmi2Component c, const fmi2Real x[], size_t n) {
  ALLOW(RF_EVENT | RF_CONTINUOUS);
  return rf_set_states(i, x, n);
}

FMI2_EXPORT fmi2Status FMI2(GetDerivatives)(fmi2Component c, fmi2Real rate[], size_t n) {
  ALLOW(RF_INITIALISING | RF_EVENT | RF_CONTINUOUS | RF_TERMINATED);
  return rf_get_rates(i, rate, n);
}

FMI2_EXPORT fmi2Status FMI2(GetEventIndicators)(fmi2Component c, fmi2Real event[], size_t n) {
  ALLOW(RF_INITIALISING | RF_EVENT | RF_CONTINUOUS | RF_TERMINATED);
  return rf_get_indicators(i, event, n);
}

FMI2_EXPORT fmi2Status FMI2(GetContinuousStates)(fmi2Component c, fmi2Real x[], size_t n) {
  INSTANCE;
  return rf_get_states(i, x, n);
}

FMI2_EXPORT fmi2Status FMI2(GetNominalsOfContinuousStates)(fmi2Component c, fmi2Real nominal[], size_t n) {
  INSTANCE;
  return rf_get_nominals(i, nominal, n);
}

/* ---- co-simulation ---- */

FMI2_EXPORT fmi2Status FMI2(SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                     const fmi2Integer order[], const fmi2Real value[]) {
  ALLOW(RF_STEPPING | RF_INITIALISING | RF_INSTANTIATED);
  return rf_set_slopes(i, __func__, vr, n, order, value);
}

FMI2_EXPORT fmi2Status FMI2(GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                      const fmi2Integer order[], fmi2Real value[]) {
  ALLOW(RF_STEPPING | RF_TERMINATED);
  return rf_output_rates(i, __func__, vr, n, order, value, -1);
}

FMI2_EXPORT fmi2Status FMI2(DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_set_state) {
  (void)no_set_state;
  INSTANCE;
  return rf_step(i, __func__, time, size);
}

FMI2_EXPORT fmi2Status FMI2(CancelStep)(fmi2Component c) {
  INSTANCE;
  return rf_log(i, RF_ERROR, "%s: steps are never pending", __func__);
}

FMI2_EXPORT fmi2Status FMI2(GetStatus)(fmi2Component c, int kind, fmi2Status *value) {
  INSTANCE;
  *value = (int)i->d[RF_PHASE] == RF_FAILED ? RF_ERROR : RF_OK;
  return kind == 0 ? RF_OK : RF_DISCARD;
}

FMI2_EXPORT fmi2Status FMI2(GetRealStatus)(fmi2Component c, int kind, fmi2Real *value) {
  INSTANCE;
  *value = i->d[RF_TIME];
  return kind == 2 ? RF_OK : RF_DISCARD; /* LastSuccessfulTime */
}

FMI2_EXPORT fmi2Status FMI2(GetIntegerStatus)(fmi2Component c, int kind, fmi2Integer *value) {
  INSTANCE;
  (void)kind, (void)value;
  return RF_DISCARD;
}

FMI2_EXPORT fmi2Status FMI2(GetBooleanStatus)(fmi2Component c, int kind, fmi2Boolean *value) {
  INSTANCE;
  *value = 0;
  return kind == 3 ? RF_OK : RF_DISCARD; /* Terminated: never by itself */
}

FMI2_EXPORT fmi2Status FMI2(GetStringStatus)(fmi2Component c, int kind, fmi2String *value) {
  INSTANCE;
  (void)kind;
  *value = "";
  return RF_DISCARD;
}
