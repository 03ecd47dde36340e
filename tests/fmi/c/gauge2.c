/* FMI 2.0, Co-Simulation: hands inputs of every type on to outputs, and tells what it was told; see gauge.py. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"

enum { PRINTS = 1, WARNS = 2, LOGS = 4, FLOODS = 8 };

typedef struct {
    double real[12]; /* 1 u, 3 stop, 4 tolerance, 5 start, 6 end_at, 7 scale, 8 last */
    int whole[12];   /* 1 steps, 2 i, 3 mode, 4 talk, 5 b, 6 flag */
    char text[200];
    const fmi2CallbackFunctions *f;
} Gauge;
#define G ((Gauge *)c)

static void say(Gauge *g, fmi2Status status, const char *category, const char *text) {
    g->f->logger(g->f->componentEnvironment, "gauge", status, category, text, g->whole[1]);
}
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String k[]) { return fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean logging) {
    Gauge *g = calloc(1, sizeof(Gauge));
    g->f = f;
    g->real[6] = 1e9, g->real[7] = 1.0, g->whole[3] = 1;
    strcpy(g->text, "none");
    return g;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real e, fmi2Real t, fmi2Boolean s, fmi2Real stop) {
    G->real[3] = s ? stop : -1.0, G->real[4] = d ? e : -1.0, G->real[5] = t, G->real[8] = t;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    for (size_t k = 0; k < n; k++) v[k] = r[k] == 2 ? G->real[7] * G->real[1] : G->real[r[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    for (size_t k = 0; k < n; k++) G->real[r[k]] = v[k];
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[]) {
    for (size_t k = 0; k < n; k++) v[k] = r[k] == 10 ? 2 * G->whole[2] : r[k] == 11 ? G->whole[3] : G->whole[r[k]];
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[]) {
    for (size_t k = 0; k < n; k++) G->whole[r[k]] = v[k];
    return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[]) {
    for (size_t k = 0; k < n; k++) v[k] = r[k] == 9 ? !G->whole[5] : G->whole[r[k]];
    return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[]) {
    for (size_t k = 0; k < n; k++) G->whole[r[k]] = v[k];
    return fmi2OK;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[]) {
    for (size_t k = 0; k < n; k++) v[k] = G->text;
    return fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[]) {
    for (size_t k = 0; k < n; k++) snprintf(G->text, sizeof G->text, "%s", v[k]);
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean unbound) {
    int talk = G->whole[4];
    G->whole[1]++;
    if (talk & PRINTS) printf("what %d\n", G->whole[1]), fflush(stdout);
    if (talk & LOGS) say(G, fmi2OK, "logEvents", "step %d");
    if (talk & FLOODS) for (int k = 0; k < 1200; k++) say(G, fmi2OK, "logEvents", "flood");
    if (t + h > G->real[6] + 1e-9) {
        G->real[8] = G->real[6];
        return fmi2Discard;
    }
    G->real[8] = t + h;
    if (talk & WARNS) {
        say(G, fmi2Warning, "logStatusWarning", "step %d is odd");
        return fmi2Warning;
    }
    return fmi2OK;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *v) { *v = 1; return fmi2OK; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *v) { *v = G->real[8]; return fmi2OK; }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
                                       const fmi2Real v[]) { return fmi2OK; }
