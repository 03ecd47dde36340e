/* FMI 1.0, Co-Simulation: a first-order lag T y' = k u - y, exact for inputs that are held; see lag.py.
   References: 1 u, 2 y, 3 T, 4 k, 5 y0; 6 has the other sign; whole numbers 1 steps, 2 fault; flags 1 open; text 1. */
#define CO_SIMULATION
#include "fmi1.h"
#include <math.h>
#include <stdio.h>
#include <unistd.h>

enum { FINE = 1, SEGV, HANG, FAIL, DISCARD, WARN, PENDING };

typedef struct {
    double t, stop, number[8];
    int whole[3], ready, first;
    Boolean open;
    char text[100];
    Callbacks f;
} Lag;
#define L ((Lag *)c)
enum { U = 1, Y, T, K, Y0, MINUS };

const char *FMI(GetTypesPlatform)(void) { return "standard32"; }
Component FMI(InstantiateSlave)(const char *name, const char *guid, const char *location, const char *mime,
                                double timeout, Boolean visible, Boolean interactive, Callbacks f, Boolean logging) {
    Lag *l = f.allocateMemory(1, sizeof *l);
    l->f = f;
    l->number[T] = 0.5, l->number[K] = 1.0, l->whole[2] = FINE;
    snprintf(l->text, sizeof l->text, "%s", mime);
    if (strcmp(guid, "{lag}") || strncmp(location, "file:///", 8)) {
        f.logger(l, name, fmiError, "error", "wrong guid %s, or no place: %.8s (%d)", guid, location, 7);
        f.freeMemory(l);
        return 0;
    }
    return l;
}
Status FMI(InitializeSlave)(Component c, double start, Boolean stops, double stop) {
    L->t = start, L->stop = stops ? stop : INFINITY, L->ready = 1, L->number[Y] = L->number[Y0];
    L->first = L->number[U] * 1000.0; /* the input that it was initialised with */
    return fmiOK;
}
Status FMI(TerminateSlave)(Component c) { return fmiOK; }
Status FMI(ResetSlave)(Component c) { return fmiError; }
void FMI(FreeSlaveInstance)(Component c) { L->f.freeMemory(c); }
Status FMI(GetReal)(Component c, const Reference r[], size_t n, double v[]) {
    for (size_t k = 0; k < n; k++) v[k] = r[k] == MINUS ? -L->number[Y] : L->number[r[k]];
    return L->ready ? fmiOK : fmiError;
}
Status FMI(SetReal)(Component c, const Reference r[], size_t n, const double v[]) {
    for (size_t k = 0; k < n; k++) L->number[r[k]] = v[k];
    return fmiOK;
}
Status FMI(GetInteger)(Component c, const Reference r[], size_t n, int v[]) {
    for (size_t k = 0; k < n; k++) v[k] = r[k] == 3 ? L->first : L->whole[r[k]];
    return fmiOK;
}
Status FMI(SetInteger)(Component c, const Reference r[], size_t n, const int v[]) {
    for (size_t k = 0; k < n; k++) L->whole[r[k]] = v[k];
    return fmiOK;
}
Status FMI(GetBoolean)(Component c, const Reference r[], size_t n, Boolean v[]) {
    for (size_t k = 0; k < n; k++) v[k] = L->open;
    return fmiOK;
}
Status FMI(SetBoolean)(Component c, const Reference r[], size_t n, const Boolean v[]) {
    for (size_t k = 0; k < n; k++) L->open = v[k];
    return fmiOK;
}
Status FMI(GetString)(Component c, const Reference r[], size_t n, const char *v[]) {
    for (size_t k = 0; k < n; k++) v[k] = L->text;
    return fmiOK;
}
Status FMI(SetString)(Component c, const Reference r[], size_t n, const char *const v[]) {
    for (size_t k = 0; k < n; k++) snprintf(L->text, sizeof L->text, "%s", v[k]);
    return fmiOK;
}
Status FMI(DoStep)(Component c, double t, double h, Boolean new) {
    static char *volatile nowhere = 0;
    if (fabs(t - L->t) > 1e-9 || t + h > L->stop + 1e-9 || !new) return fmiError;
    int late = t < 0.5 - 1e-9 ? FINE : L->whole[2];
    if (late == SEGV) *nowhere = 1;
    if (late == HANG) for (;;) sleep(1);
    if (late == FAIL) {
        L->f.logger(c, "lag", fmiError, "error", "tired at %g s", t);
        return fmiError;
    }
    if (late == DISCARD) return fmiDiscard;
    if (late == PENDING) return fmiPending;
    double *y = &L->number[Y], goal = L->open ? 0.0 : L->number[K] * L->number[U];
    *y = goal + (*y - goal) * exp(-h / L->number[T]);
    L->t = t + h;
    L->whole[1]++;
    return late == WARN ? fmiWarning : fmiOK;
}
Status FMI(CancelStep)(Component c) { return fmiOK; }
Status FMI(SetRealInputDerivatives)(Component c, const Reference r[], size_t n, const int o[], const double v[]) {
    return fmiOK;
}
Status FMI(GetRealOutputDerivatives)(Component c, const Reference r[], size_t n, const int o[], double v[]) {
    for (size_t k = 0; k < n; k++) v[k] = (L->number[K] * L->number[U] - L->number[Y]) / L->number[T];
    return fmiOK;
}
Status FMI(GetStatus)(Component c, int kind, Status *v) { return fmiDiscard; }
Status FMI(GetRealStatus)(Component c, int kind, double *v) { *v = L->t; return kind == 2 ? fmiOK : fmiDiscard; }
Status FMI(GetIntegerStatus)(Component c, int kind, int *v) { return fmiDiscard; }
Status FMI(GetBooleanStatus)(Component c, int kind, Boolean *v) { return fmiDiscard; }
Status FMI(GetStringStatus)(Component c, int kind, const char **v) { return fmiDiscard; }
