/* FMI 3.0, Co-Simulation: y = k u, entry by entry, of as many entries as the structural parameter 1 says. */
#include <stdlib.h>
#include "fmi3Functions.h"

enum { MOST = 16 };
typedef struct { unsigned long long n; double u[MOST], k[MOST]; int configuring; } Sized;
#define S ((Sized *)c)

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String where, fmi3Boolean visible,
    fmi3Boolean log, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference r[], size_t n,
    fmi3InstanceEnvironment e, fmi3LogMessageCallback l, fmi3IntermediateUpdateCallback i) {
    Sized *c = calloc(1, sizeof(Sized));
    c->n = 2;
    for (int k = 0; k < MOST; k++) c->k[k] = 5.0, c->u[k] = k + 1.0;
    return c;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { S->configuring = 1; return fmi3OK; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { S->configuring = 0; return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean d, fmi3Float64 e, fmi3Float64 t, fmi3Boolean s,
    fmi3Float64 stop) { return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3SetUInt64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3UInt64 v[], size_t m) {
    if (!S->configuring || v[0] > MOST) return fmi3Error;
    S->n = v[0];
    return fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t m) {
    if (n != 1 || m != S->n) return fmi3Error;
    for (size_t k = 0; k < m; k++) (r[0] == 2 ? S->u : S->k)[k] = v[k];
    return fmi3OK;
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m) {
    if (n != 1 || m != S->n) return fmi3Error;
    for (size_t k = 0; k < m; k++) v[k] = r[0] == 2 ? S->u[k] : r[0] == 4 ? S->k[k] : S->k[k] * S->u[k];
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean unbound, fmi3Boolean *event,
    fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    *event = *end = *early = 0, *last = t + h;
    return fmi3OK;
}
