/* FMI 1.0, Model Exchange: events.h. An event is iterated inside, unless intermediate results are asked for. */
#include "events.h"
#include "fmi1.h"
#define S ((System *)c)

const char *FMI(GetModelTypesPlatform)(void) { return "standard32"; }
Component FMI(InstantiateModel)(const char *name, const char *guid, Callbacks f, Boolean logging) {
    System *s = f.allocateMemory(1, sizeof *s);
    begin(s);
    return s;
}
void FMI(FreeModelInstance)(Component c) { free(c); }
static Status tell(System *s, Boolean intermediate, EventInfo *info) {
    memset(info, 0, sizeof *info);
    do info->iterationConverged = !update(s);
    while (!info->iterationConverged && !intermediate);
    info->stateValuesChanged = 1;
    info->upcomingTimeEvent = isfinite(s->next) != 0;
    info->nextEventTime = s->next;
    info->terminateSimulation = s->count >= s->stop_at || (s->model == LATE && s->t >= s->stop_at);
    return fmiOK;
}
Status FMI(Initialize)(Component c, Boolean controlled, double tolerance, EventInfo *info) { return tell(S, 0, info); }
Status FMI(EventUpdate)(Component c, Boolean intermediate, EventInfo *info) { return tell(S, intermediate, info); }
Status FMI(Terminate)(Component c) { return fmiOK; }
Status FMI(GetReal)(Component c, const Reference r[], size_t n, double v[]) {
    return S->begun ? get(S, r, n, v) : fmiError; /* not before the initialisation */
}
Status FMI(SetReal)(Component c, const Reference r[], size_t n, const double v[]) { return set(S, r, n, v); }
Status FMI(GetInteger)(Component c, const Reference r[], size_t n, int v[]) { v[0] = S->model; return fmiOK; }
Status FMI(SetInteger)(Component c, const Reference r[], size_t n, const int v[]) { S->model = v[0]; return fmiOK; }
Status FMI(GetBoolean)(Component c, const Reference r[], size_t n, Boolean v[]) { return fmiError; }
Status FMI(SetBoolean)(Component c, const Reference r[], size_t n, const Boolean v[]) { return fmiError; }
Status FMI(GetString)(Component c, const Reference r[], size_t n, const char *v[]) { return fmiError; }
Status FMI(SetString)(Component c, const Reference r[], size_t n, const char *const v[]) { return fmiError; }
Status FMI(CompletedIntegratorStep)(Component c, Boolean *event) {
    *event = S->model == LATE && (S->x >= S->high || S->t >= S->stop_at); /* the end is said in the event */
    return fmiOK;
}
Status FMI(SetTime)(Component c, double t) { S->t = t; return fmiOK; }
Status FMI(SetContinuousStates)(Component c, const double x[], size_t n) { S->x = x[0], S->v = x[1]; return fmiOK; }
Status FMI(GetContinuousStates)(Component c, double x[], size_t n) { x[0] = S->x, x[1] = S->v; return fmiOK; }
Status FMI(GetNominalContinuousStates)(Component c, double x[], size_t n) { x[0] = x[1] = 1.0; return fmiOK; }
Status FMI(GetStateValueReferences)(Component c, Reference r[], size_t n) { r[0] = 1, r[1] = 2; return fmiOK; }
Status FMI(GetDerivatives)(Component c, double d[], size_t n) { slope(S, d, d + 1); return fmiOK; }
Status FMI(GetEventIndicators)(Component c, double z[], size_t n) { z[0] = indicator(S); return fmiOK; }
