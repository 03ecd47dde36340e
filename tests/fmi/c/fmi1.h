/* Types of FMI 1.0, as far as FMUs for tests need them; the names of functions begin with the modelIdentifier. */
#include <stdlib.h>
#include <string.h>

#define FMI(name) plant_fmi##name
typedef void *Component;
typedef unsigned int Reference;
typedef char Boolean;
typedef enum { fmiOK, fmiWarning, fmiDiscard, fmiError, fmiFatal, fmiPending } Status;
typedef void (*Logger)(Component, const char *name, Status, const char *category, const char *message, ...);
typedef struct {
    Logger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
#ifdef CO_SIMULATION
    void (*stepFinished)(Component, Status);
#endif
} Callbacks;
typedef struct {
    Boolean iterationConverged, stateValueReferencesChanged, stateValuesChanged, terminateSimulation, upcomingTimeEvent;
    double nextEventTime;
} EventInfo;

const char *FMI(GetVersion)(void) { return "1.0"; }
Status FMI(SetDebugLogging)(Component c, Boolean on) { return fmiOK; }
