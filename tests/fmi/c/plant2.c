/* FMI 2.0, one direction. References: 1 x, 2 v, 3 der(x), 4 der(v), 5 u, 6 y, 7... parameters; see plant.py. */
#define N 1
#include "plant.h"
#include "fmi2Functions.h"
#define P ((Plant *)c)

static void say(Plant *p, fmi2Status status, const char *category, const char *text, double a, int b, const char *s) {
    const fmi2CallbackFunctions *f = p->logger;
    if (f && f->logger) f->logger(f->componentEnvironment, p->name, status, category, text, a, b, s);
}
static void chatter(Plant *p, int k) { say(p, fmi2OK, "logAll", "t = %g: flood %d%s", p->t, k, ""); }
static double *number(Plant *p, unsigned r) {
    switch (r) {
        case 0: return &p->t;
        case 1: return p->x;
        case 2: return p->v;
        case 5: return p->u;
        case 7: return &p->stiffness;
        case 8: return &p->damping;
        case 9: return &p->gain;
        case 10: return &p->wall;
        case 11: return &p->tick;
        case 12: return &p->fault_time;
        case 13: return &p->fault_above;
    }
    return 0;
}
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String k[]) { return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean logging) {
    Plant *p = f->allocateMemory(1, sizeof(Plant));
    begin(p);
    p->logger = (void *)f;
    p->name = "plant";
    if (strcmp(guid, "{plant2}")) {
        say(p, fmi2Error, "logStatusError", "wrong guid (%g, %d, %s)", 2.5, -7, guid);
        f->freeMemory(p);
        return 0;
    }
    return p;
}
void fmi2FreeInstance(fmi2Component c) {
    if (P->fault == BAD_FREE) raise(SIGSEGV);
    ((const fmi2CallbackFunctions *)P->logger)->freeMemory(c);
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real e, fmi2Real t, fmi2Boolean s, fmi2Real stop) {
    P->t = t;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { tick(P); return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return P->fault == TERMINATE ? fmi2Error : fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) {
    if (P->fault == NO_RESET) return fmi2Error;
    begin(P);
    P->resets++;
    return fmi2OK;
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
    double dx[N], dv[N];
    slope(P, P->x, P->v, dx, dv);
    for (size_t k = 0; k < n; k++) {
        double *at = number(P, r[k]);
        if (at) value[k] = *at;
        else if (r[k] == 3) value[k] = dx[0];
        else if (r[k] == 4) value[k] = dv[0];
        else if (r[k] == 6) value[k] = P->x[0] + P->gain * P->u[0];
        else return fmi2Error;
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) {
        double *at = number(P, r[k]);
        if (!at) { say(P, fmi2Error, "logStatusError", "reference %g, %d (%s) cannot be set", 0.0, (int)r[k], "?"); return fmi2Error; }
        *at = value[k];
    }
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer value[]) {
    for (size_t k = 0; k < n; k++) value[k] = r[k] == 20 ? P->fault : P->count;
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer value[]) {
    for (size_t k = 0; k < n; k++) if (r[k] == 20) P->fault = value[k]; else P->count = value[k];
    return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean value[]) {
    for (size_t k = 0; k < n; k++) value[k] = P->enabled;
    return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean value[]) {
    for (size_t k = 0; k < n; k++) P->enabled = value[k];
    return fmi2OK;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String value[]) {
    for (size_t k = 0; k < n; k++) value[k] = P->label;
    return fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String value[]) {
    for (size_t k = 0; k < n; k++) snprintf(P->label, sizeof P->label, "%s", value[k]);
    return fmi2OK;
}
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) {
    if (!*s) *s = malloc(sizeof(Plant));
    memcpy(*s, c, sizeof(Plant));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { memcpy(c, s, sizeof(Plant)); return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { free(*s); *s = 0; return fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) { *n = sizeof(Plant); return fmi2OK; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte data[], size_t n) { memcpy(data, s, n); return fmi2OK; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte data[], size_t n, fmi2FMUstate *s) {
    *s = malloc(n);
    memcpy(*s, data, n);
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference of[], size_t n,
                                        const fmi2ValueReference by[], size_t m, const fmi2Real seed[], fmi2Real out[]) {
    for (size_t i = 0; i < n; i++) {
        out[i] = 0.0;
        for (size_t j = 0; j < m; j++) {
            double d = 0.0;
            if (of[i] == 3) d = by[j] == 2;
            if (of[i] == 4) d = by[j] == 1 ? -P->stiffness : by[j] == 2 ? -P->damping : by[j] == 5;
            if (of[i] == 6) d = by[j] == 1 ? 1.0 : by[j] == 5 ? P->gain : 0.0;
            out[i] += d * seed[j];
        }
    }
    return fmi2OK;
}
fmi2Status fmi2EnterEventMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    tick(P);
    memset(info, 0, sizeof *info);
    info->valuesOfContinuousStatesChanged = info->newDiscreteStatesNeeded = bounce(P);
    info->nextEventTimeDefined = isfinite(P->next);
    info->nextEventTime = P->next;
    info->terminateSimulation = P->fault == TERMINATE && P->count >= 3;
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no, fmi2Boolean *event, fmi2Boolean *end) {
    *event = P->count == 99, *end = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { P->t = t; return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { P->x[0] = x[0], P->v[0] = x[1]; return fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n) {
    int status = misbehave(P, P->t);
    slope(P, P->x, P->v, d, d + 1);
    return status;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { z[0] = P->x[0] - P->wall; return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = P->x[0], x[1] = P->v[0]; return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { x[0] = 1.0, x[1] = 10.0; return fmi2OK; }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[]) {
    if (order[0] == 1) P->label[0] = value[0] == 3.0 ? '3' : '?'; /* shows what came */
    return fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[],
                                        fmi2Real value[]) { value[0] = P->v[0]; return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no) {
    int status = misbehave(P, t);
    if (status) {
        say(P, status, "logStatusError", "step of %g s refused, code %d in %s", h, status, P->label);
        return status;
    }
    advance(P, h);
    bounce(P);
    tick(P);
    return fmi2OK;
}
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *v) { return fmi2Discard; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *v) { *v = P->t; return fmi2OK; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *v) { return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *v) { *v = 0; return fmi2OK; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *v) { return fmi2Discard; }
