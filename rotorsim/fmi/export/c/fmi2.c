/* FMI 2.0, model exchange and co-simulation, over instance.h. Compile this file alone:
 *   cc -std=c99 -O3 -fPIC -shared -ffp-contract=off fmi2.c -o <modelIdentifier>.so -lm
 * Types and signatures are those of the FMI 2.0.5 standard, platform "default".
 */
#include "model.inc"

#include "instance.h"

#include "derivatives.h"

#include "stepping.h"

typedef void *fmi2Component;
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

#define RF_FMI fmi2
#if defined(FMI2_FUNCTION_PREFIX)
#define RF_PREFIX FMI2_FUNCTION_PREFIX
#endif
#define RF_BOOLEAN fmi2Boolean
#define RF_BYTE fmi2Byte
#define RF_STATE FMUstate
#define RF_DESERIALIZE DeSerializeFMUstate
#define RF_DERIVATIVES GetDerivatives
#include "functions.h"

RF_EXPORT const char *FMI(GetTypesPlatform)(void) { return "default"; }
RF_EXPORT const char *FMI(GetVersion)(void) { return "2.0"; }

RF_EXPORT fmi2Component FMI(Instantiate)(fmi2String name, fmi2Type kind, fmi2String guid, fmi2String resources,
                                         const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                         fmi2Boolean log) {
  (void)visible;
  return rf_create(name, guid, resources, kind, log, functions ? functions->componentEnvironment : 0,
                   functions ? (void (*)(void))functions->logger : 0);
}

RF_EXPORT fmi2Status FMI(SetupExperiment)(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                          fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
  (void)tolerance_defined, (void)tolerance;
  ALLOW(RF_INSTANTIATED);
  i->d[RF_START] = start;
  i->d[RF_STOP] = stop_defined ? stop : HUGE_VAL;
  return RF_OK;
}

RF_EXPORT fmi2Status FMI(EnterInitializationMode)(fmi2Component c) {
  ALLOW(RF_INSTANTIATED);
  return rf_enter_initialisation(i, i->d[RF_START], i->d[RF_STOP]);
}

/* ---- variables: all are Real ---- */

RF_EXPORT fmi2Status FMI(GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  INSTANCE;
  return rf_get(i, __func__, vr, n, value, -1);
}

RF_EXPORT fmi2Status FMI(SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  INSTANCE;
  return rf_set(i, __func__, vr, n, value, -1);
}

#define NONE_OF(kind, type, access)                                                                               \
  RF_EXPORT fmi2Status FMI(kind)(fmi2Component c, const fmi2ValueReference vr[], size_t n, access type value[]) { \
    INSTANCE;                                                                                                     \
    (void)vr, (void)value;                                                                                        \
    return n == 0 ? RF_OK : rf_log(i, RF_ERROR, "%s: all variables of this FMU are Real", __func__);              \
  }
NONE_OF(GetInteger, fmi2Integer, )
NONE_OF(GetBoolean, fmi2Boolean, )
NONE_OF(GetString, fmi2String, )
NONE_OF(SetInteger, fmi2Integer, const)
NONE_OF(SetBoolean, fmi2Boolean, const)
NONE_OF(SetString, fmi2String, const)

/* ---- derivatives ---- */

RF_EXPORT fmi2Status FMI(GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknowns[],
                                                   size_t n_unknowns, const fmi2ValueReference knowns[],
                                                   size_t n_knowns, const fmi2Real seed[], fmi2Real result[]) {
  INSTANCE;
  return rf_directional(i, __func__, unknowns, n_unknowns, knowns, n_knowns, seed, -1, result, -1, 1);
}

/* ---- model exchange ---- */

RF_EXPORT fmi2Status FMI(NewDiscreteStates)(fmi2Component c, fmi2EventInfo *info) {
  ALLOW(RF_EVENT);
  const double next = rf_update(i);
  memset(info, 0, sizeof *info);
  info->nextEventTimeDefined = next < HUGE_VAL;
  info->nextEventTime = next < HUGE_VAL ? next : 0.0;
  info->terminateSimulation = i->ended;
  info->valuesOfContinuousStatesChanged = rf_changed(i, 0);
  info->nominalsOfContinuousStatesChanged = rf_changed(i, 1);
  return rf_outcome(i);
}

/* ---- co-simulation ---- */

RF_EXPORT fmi2Status FMI(SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                  const fmi2Integer order[], const fmi2Real value[]) {
  ALLOW(RF_STEPPING | RF_INITIALISING | RF_INSTANTIATED);
  return rf_set_slopes(i, __func__, vr, n, order, value);
}

RF_EXPORT fmi2Status FMI(GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                   const fmi2Integer order[], fmi2Real value[]) {
  ALLOW(RF_STEPPING | RF_TERMINATED);
  return rf_output_rates(i, __func__, vr, n, order, value, -1);
}

RF_EXPORT fmi2Status FMI(DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_set_state) {
  (void)no_set_state;
  INSTANCE;
  return rf_step(i, __func__, time, size);
}

RF_EXPORT fmi2Status FMI(CancelStep)(fmi2Component c) {
  INSTANCE;
  return rf_log(i, RF_ERROR, "%s: steps are never pending", __func__);
}

RF_EXPORT fmi2Status FMI(GetStatus)(fmi2Component c, int kind, fmi2Status *value) {
  INSTANCE;
  *value = (int)i->d[RF_PHASE] == RF_FAILED ? RF_ERROR : RF_OK;
  return kind == 0 ? RF_OK : RF_DISCARD;
}

RF_EXPORT fmi2Status FMI(GetRealStatus)(fmi2Component c, int kind, fmi2Real *value) {
  INSTANCE;
  *value = i->d[RF_TIME];
  return kind == 2 ? RF_OK : RF_DISCARD; /* LastSuccessfulTime */
}

RF_EXPORT fmi2Status FMI(GetIntegerStatus)(fmi2Component c, int kind, fmi2Integer *value) {
  INSTANCE;
  (void)kind, (void)value;
  return RF_DISCARD;
}

RF_EXPORT fmi2Status FMI(GetBooleanStatus)(fmi2Component c, int kind, fmi2Boolean *value) {
  INSTANCE;
  *value = i->ended;
  return kind == 3 ? RF_OK : RF_DISCARD; /* Terminated: by an FMU inside */
}

RF_EXPORT fmi2Status FMI(GetStringStatus)(fmi2Component c, int kind, fmi2String *value) {
  INSTANCE;
  (void)kind;
  *value = "";
  return RF_DISCARD;
}
