/* FMI 3.0, two directions, arrays. References: 0 time, 1 x, 2 v, 3 der(x), 4 der(v), 5 u, 6 y; see plant.py. */
#define N 2
#include "plant.h"
#include "fmi3Functions.h"
#define P ((Plant *)c)
#define GET(T) fmi3Status fmi3Get##T(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3##T v[], size_t m)
#define SET(T) fmi3Status fmi3Set##T(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3##T v[], size_t m)
#define NONE(T) GET(T) { return fmi3Error; } SET(T) { return fmi3Error; }

static void say(Plant *p, fmi3Status status, const char *text) {
    if (p->logger) ((fmi3LogMessageCallback)p->logger)(p->environment, status, "logStatusError", text);
}
static void chatter(Plant *p, int k) {
    char text[64];
    snprintf(text, sizeof text, "t = %g: flood %d", p->t, k);
    if (p->logger) ((fmi3LogMessageCallback)p->logger)(p->environment, fmi3OK, "logAll", text);
}
static double *number(Plant *p, unsigned r, size_t *size) {
    *size = 1;
    switch (r) {
        case 0: return &p->t;
        case 1: *size = N; return p->x;
        case 2: *size = N; return p->v;
        case 5: *size = N; return p->u;
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
static void *made(fmi3String token, fmi3InstanceEnvironment e, fmi3LogMessageCallback log) {
    Plant *p = calloc(1, sizeof(Plant));
    begin(p);
    p->logger = (void *)log, p->environment = e;
    if (strcmp(token, "{plant3}")) { say(p, fmi3Error, "wrong token"); free(p); return 0; }
    return p;
}
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String k[]) { return fmi3OK; }
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
        fmi3Boolean logging, fmi3InstanceEnvironment e, fmi3LogMessageCallback log) { return made(token, e, log); }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
        fmi3Boolean logging, fmi3Boolean event, fmi3Boolean early, const fmi3ValueReference r[], size_t n,
        fmi3InstanceEnvironment e, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback u) { return made(token, e, log); }
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean d, fmi3Float64 e, fmi3Float64 t, fmi3Boolean s,
        fmi3Float64 stop) { P->t = t; return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { tick(P); return fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { begin(P); return fmi3OK; }
GET(Float64) {
    double dx[N], dv[N];
    slope(P, P->x, P->v, dx, dv);
    for (size_t k = 0; k < n; k++) {
        size_t size;
        double *at = number(P, r[k], &size);
        if (r[k] == 3) at = dx, size = N;
        if (r[k] == 4) at = dv, size = N;
        if (r[k] == 50) {
            for (int i = 0; i < N; i++) *v++ = P->x[i] - P->wall;
            continue;
        }
        if (r[k] == 6) {
            for (int i = 0; i < N; i++) *v++ = P->x[i] + P->gain * P->u[i];
            continue;
        }
        if (!at) return fmi3Error;
        memcpy(v, at, size * sizeof *v);
        v += size;
    }
    return fmi3OK;
}
SET(Float64) {
    for (size_t k = 0; k < n; k++) {
        size_t size;
        double *at = number(P, r[k], &size);
        if (!at) { say(P, fmi3Error, "it cannot be set"); return fmi3Error; }
        memcpy(at, v, size * sizeof *v);
        v += size;
    }
    return fmi3OK;
}
GET(Int32) { for (size_t k = 0; k < n; k++) v[k] = r[k] == 20 ? P->fault : P->count; return fmi3OK; }
SET(Int32) { for (size_t k = 0; k < n; k++) if (r[k] == 20) P->fault = v[k]; else P->count = v[k]; return fmi3OK; }
GET(Boolean) { for (size_t k = 0; k < n; k++) v[k] = P->enabled; return fmi3OK; }
SET(Boolean) { for (size_t k = 0; k < n; k++) P->enabled = v[k]; return fmi3OK; }
GET(String) { for (size_t k = 0; k < n; k++) v[k] = P->label; return fmi3OK; }
SET(String) { for (size_t k = 0; k < n; k++) snprintf(P->label, sizeof P->label, "%s", v[k]); return fmi3OK; }
NONE(Float32) NONE(Int8) NONE(UInt8) NONE(Int16) NONE(UInt16) NONE(UInt32) NONE(Int64) NONE(UInt64)
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) {
    if (!*s) *s = malloc(sizeof(Plant));
    memcpy(*s, c, sizeof(Plant));
    return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { memcpy(c, s, sizeof(Plant)); return fmi3OK; }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { free(*s); *s = 0; return fmi3OK; }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n) { *n = sizeof(Plant); return fmi3OK; }
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte data[], size_t n) { memcpy(data, s, n); return fmi3OK; }
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte data[], size_t n, fmi3FMUState *s) {
    *s = malloc(n);
    memcpy(*s, data, n);
    return fmi3OK;
}
/* Of der(x) (3), der(v) (4) and y (6), by x (1), v (2) and u (5). */
static double slope_by(const Plant *p, unsigned of, unsigned by) {
    if (of == 3) return by == 2 ? 1.0 : 0.0;
    if (of == 6) return by == 1 ? 1.0 : by == 5 ? p->gain : 0.0;
    return of != 4 ? 0.0 : by == 5 ? 1.0 : by == 1 ? -p->stiffness : -p->damping;
}

/* out += J seed, or J^T seed; J of the unknowns `of` by the knowns `by`. */
static fmi3Status product(const Plant *p, const fmi3ValueReference of[], size_t n, const fmi3ValueReference by[], size_t m,
        const fmi3Float64 seed[], fmi3Float64 out[], size_t no, int transposed) {
    for (size_t k = 0; k < no; k++) out[k] = 0.0;
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < m; j++)
            for (int k = 0; k < N; k++)
                out[N * (transposed ? j : i) + k] += seed[N * (transposed ? i : j) + k] * slope_by(p, of[i], by[j]);
    return fmi3OK;
}
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference of[], size_t n,
        const fmi3ValueReference by[], size_t m, const fmi3Float64 seed[], size_t ns, fmi3Float64 out[], size_t no) {
    return product(P, of, n, by, m, seed, out, no, 0);
}
fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference of[], size_t n,
        const fmi3ValueReference by[], size_t m, const fmi3Float64 seed[], size_t ns, fmi3Float64 out[], size_t no) {
    return product(P, of, n, by, m, seed, out, no, 1);
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *more, fmi3Boolean *end, fmi3Boolean *nominals,
        fmi3Boolean *states, fmi3Boolean *defined, fmi3Float64 *next) {
    tick(P);
    *end = *nominals = fmi3False;
    *states = *more = bounce(P);
    *defined = isfinite(P->next);
    *next = P->next;
    return fmi3OK;
}
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no, fmi3Boolean *event, fmi3Boolean *end) {
    *event = P->count == 99, *end = fmi3False;
    return fmi3OK;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { P->t = t; return fmi3OK; }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    memcpy(P->x, x, sizeof P->x);
    memcpy(P->v, x + N, sizeof P->v);
    return fmi3OK;
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 d[], size_t n) {
    int status = misbehave(P, P->t);
    slope(P, P->x, P->v, d, d + N);
    return status;
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) {
    for (int k = 0; k < N; k++) z[k] = P->x[k] - P->wall;
    return fmi3OK;
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    memcpy(x, P->x, sizeof P->x);
    memcpy(x + N, P->v, sizeof P->v);
    return fmi3OK;
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    for (size_t k = 0; k < n; k++) x[k] = k < N ? 1.0 : 10.0;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { *n = N; return fmi3OK; }
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { *n = 2 * N; return fmi3OK; }
fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int32 o[],
        fmi3Float64 v[], size_t m) { memcpy(v, P->v, sizeof P->v); return fmi3OK; }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no, fmi3Boolean *event, fmi3Boolean *end,
        fmi3Boolean *early, fmi3Float64 *last) {
    int status = misbehave(P, t);
    *event = *early = fmi3False;
    *end = P->fault == TERMINATE && t >= P->fault_time;
    *last = P->t;
    if (status) { say(P, status, "the step is refused"); return status; }
    advance(P, h);
    bounce(P);
    tick(P);
    *last = P->t;
    return fmi3OK;
}
