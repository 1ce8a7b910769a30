/* FMI 2.0 or 3.0 (FMI of table.h) for co-simulation, as the standards describe; the declarations are our own. */
#include "instance.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define JOINED(prefix, name) prefix##name

/* What differs: prefix, boolean type, name of numbers, spelling of states, number of values beside references. */
#if FMI == 2
#define F(name) JOINED(fmi2, name)
#define PREFIX "fmi2"
#define STATE(before, after) JOINED(fmi2, before##FMUstate##after)
#define DESERIALISE fmi2DeSerializeFMUstate
#define NUMBERS(verb) JOINED(fmi2, verb##Real)
#define ALSO_VALUES
#define VALUES number
typedef int boolean;
#else
#define F(name) JOINED(fmi3, name)
#define PREFIX "fmi3"
#define STATE(before, after) JOINED(fmi3, before##FMUState##after)
#define DESERIALISE fmi3DeserializeFMUState
#define NUMBERS(verb) JOINED(fmi3, verb##Float64)
#define ALSO_VALUES , size_t values
#define VALUES values
typedef bool boolean;
#endif

static const char *category(enum status status)
{
    return status == DISCARD ? "logStatusDiscard" : "logStatusError";
}

#if FMI == 2
typedef void logger2(void *environment, const char *name, int status, const char *category, const char *message, ...);

typedef struct {
    logger2 *logger;
    void *(*allocate)(size_t number, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
} callbacks;

/* The message is a format of printf in FMI 2, so per cent signs are doubled. */
static void report(instance *it, enum status status, const char *text)
{
    char *format = malloc(2 * strlen(text) + 1), *to = format;

    if (format == NULL || it->logger == NULL) {
        free(format);
        return;
    }
    for (; *text != '\0'; text++) {
        if (*text == '%')
            *to++ = '%';
        *to++ = *text;
    }
    *to = '\0';
    ((logger2 *)it->logger)(it->environment, it->name, status, category(status), format);
    free(format);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT instance *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                                 const callbacks *host, int visible, int logging)
{
    (void)visible, (void)logging;
    if (host == NULL || type != 1) /* co-simulation */
        return NULL;
    return instance_new(name, token, resources, report, host->environment, (void (*)(void))host->logger);
}

/* The case defines the accuracy: tolerances are ignored. */
EXPORT int fmi2SetupExperiment(instance *it, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance;
    return set_times(it, start, has_stop, stop);
}

EXPORT int fmi2EnterInitializationMode(instance *it) { return enter_initialisation(it); }

EXPORT int fmi2DoStep(instance *it, double begin, double length, int keeps_no_state)
{
    (void)keeps_no_state;
    return step(it, begin, length);
}
#else
typedef void logger3(void *environment, int status, const char *category, const char *message);

static void report(instance *it, enum status status, const char *text)
{
    if (it->logger != NULL)
        ((logger3 *)it->logger)(it->environment, status, category(status), text);
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT instance *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                             bool logging, bool event_mode, bool early_return,
                                             const unsigned intermediate[], size_t number, void *environment,
                                             logger3 *logger, void (*update)(void))
{
    (void)visible, (void)logging, (void)event_mode, (void)early_return, (void)intermediate, (void)number, (void)update;
    return instance_new(name, token, resources, report, environment, (void (*)(void))logger);
}

/* The case defines the accuracy: tolerances are ignored. */
EXPORT int fmi3EnterInitializationMode(instance *it, bool has_tolerance, double tolerance, double start, bool has_stop,
                                       double stop)
{
    (void)has_tolerance, (void)tolerance;
    return set_times(it, start, has_stop, stop) != OK ? ERROR : (int)enter_initialisation(it);
}

EXPORT int fmi3DoStep(instance *it, double begin, double length, bool keeps_no_state, bool *event, bool *ends,
                      bool *early, double *last)
{
    int status;

    (void)keeps_no_state;
    if (event != NULL)
        *event = false;
    if (ends != NULL)
        *ends = false;
    if (early != NULL)
        *early = false;
    status = step(it, begin, length);
    if (last != NULL && it != NULL)
        *last = it->time;
    return status;
}
#endif

EXPORT int F(SetDebugLogging)(instance *it, boolean on, size_t number, const char *const categories[])
{
    (void)on, (void)number, (void)categories; /* only errors are logged */
    return it == NULL ? ERROR : OK;
}

EXPORT void F(FreeInstance)(instance *it) { instance_free(it); }
EXPORT int F(ExitInitializationMode)(instance *it) { return exit_initialisation(it); }
EXPORT int F(Terminate)(instance *it) { return terminate(it); }
EXPORT int F(Reset)(instance *it) { return reset(it); }

static int is_counted(instance *it, const char *function, size_t number, size_t values)
{
    if (it != NULL && number != values)
        fail(it, PREFIX "%s: %zu variables have %zu values", function, number, values);
    return it != NULL && number == values;
}

EXPORT int NUMBERS(Get)(instance *it, const unsigned reference[], size_t number, double value[] ALSO_VALUES)
{
    return is_counted(it, "GetFloat64", number, VALUES) ? get(it, reference, number, NUMBER, value) : ERROR;
}

EXPORT int NUMBERS(Set)(instance *it, const unsigned reference[], size_t number, const double value[] ALSO_VALUES)
{
    return is_counted(it, "SetFloat64", number, VALUES) ? set(it, reference, number, NUMBER, value) : ERROR;
}

EXPORT int F(GetBoolean)(instance *it, const unsigned reference[], size_t number, boolean value[] ALSO_VALUES)
{
    size_t k;
    double found;

    if (!is_counted(it, "GetBoolean", number, VALUES))
        return ERROR;
    for (k = 0; k < number; k++) {
        if (get(it, reference + k, 1, SWITCH, &found) != OK)
            return ERROR;
        value[k] = found != 0.0;
    }
    return OK;
}

EXPORT int F(SetBoolean)(instance *it, const unsigned reference[], size_t number, const boolean value[] ALSO_VALUES)
{
    size_t k;

    if (!is_counted(it, "SetBoolean", number, VALUES))
        return ERROR;
    for (k = 0; k < number; k++) {
        const double given = value[k] != 0;
        if (set(it, reference + k, 1, SWITCH, &given) != OK)
            return ERROR;
    }
    return OK;
}

EXPORT int STATE(Get, )(instance *it, void **place) { return keep(it, place); }
EXPORT int STATE(Set, )(instance *it, void *kept) { return restore(it, kept); }
EXPORT int STATE(Free, )(instance *it, void **place) { return forget(it, place); }
EXPORT int STATE(Serialized, Size)(instance *it, void *kept, size_t *size) { return packed_size(it, kept, size); }

EXPORT int STATE(Serialize, )(instance *it, void *kept, char bytes[], size_t size)
{
    return pack(it, kept, bytes, size);
}

EXPORT int DESERIALISE(instance *it, const char bytes[], size_t size, void **place)
{
    return unpack(it, bytes, size, place);
}

/* Functions for variables, modes and kinds of FMU that do not exist here. Hosts call them with more arguments
 * than they are declared with, which the C calling conventions of Linux allow: the caller clears the stack. */
#define ABSENT(name) \
    EXPORT int F(name)(instance *it) { return refuse(it, PREFIX #name); }
/* The same where a request for no variable is valid. */
#define NO_VARIABLES(name)                                                       \
    EXPORT int F(name)(instance *it, const unsigned reference[], size_t number)  \
    {                                                                            \
        (void)reference;                                                         \
        return number == 0 && it != NULL ? OK : (int)refuse(it, PREFIX #name);   \
    }
#define NO_TYPE(type) NO_VARIABLES(Get##type) NO_VARIABLES(Set##type)

NO_TYPE(String)
ABSENT(GetDirectionalDerivative)

#if FMI == 2
NO_TYPE(Integer)
ABSENT(SetRealInputDerivatives)
ABSENT(GetRealOutputDerivatives)
ABSENT(CancelStep)

/* Steps end before doStep returns, so nothing is pending; a discarded one leaves the time where it was. */
EXPORT int fmi2GetStatus(instance *it, int kind, int *value)
{
    (void)kind;
    if (it != NULL && value != NULL)
        *value = OK;
    return it == NULL ? ERROR : OK;
}

EXPORT int fmi2GetRealStatus(instance *it, int kind, double *value)
{
    if (it == NULL || value == NULL || kind != 2) /* the last successful time */
        return DISCARD;
    *value = it->time;
    return OK;
}

EXPORT int fmi2GetBooleanStatus(instance *it, int kind, int *value)
{
    if (it == NULL || value == NULL || kind != 3) /* whether the FMU ends the simulation */
        return DISCARD;
    *value = 0;
    return OK;
}

EXPORT int fmi2GetIntegerStatus(instance *it) { return (void)it, DISCARD; }
EXPORT int fmi2GetStringStatus(instance *it) { return (void)it, DISCARD; }
#else
NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_TYPE(UInt64)
NO_TYPE(Binary)
NO_TYPE(Clock)

ABSENT(EnterConfigurationMode)
ABSENT(ExitConfigurationMode)
ABSENT(EnterEventMode)
ABSENT(EnterStepMode)
ABSENT(EnterContinuousTimeMode)
ABSENT(GetNumberOfVariableDependencies)
ABSENT(GetVariableDependencies)
ABSENT(GetAdjointDerivative)
ABSENT(GetIntervalDecimal)
ABSENT(GetIntervalFraction)
ABSENT(GetShiftDecimal)
ABSENT(GetShiftFraction)
ABSENT(SetIntervalDecimal)
ABSENT(SetIntervalFraction)
ABSENT(SetShiftDecimal)
ABSENT(SetShiftFraction)
ABSENT(EvaluateDiscreteStates)
ABSENT(UpdateDiscreteStates)
ABSENT(CompletedIntegratorStep)
ABSENT(SetContinuousStates)
ABSENT(GetContinuousStateDerivatives)
ABSENT(GetEventIndicators)
ABSENT(GetContinuousStates)
ABSENT(GetNominalsOfContinuousStates)
ABSENT(GetNumberOfEventIndicators)
ABSENT(GetNumberOfContinuousStates)
ABSENT(GetOutputDerivatives)
ABSENT(ActivateModelPartition)

/* Hosts that take this FMU for a model that they integrate themselves. */
EXPORT int fmi3SetTime(instance *it, double time)
{
    if (it == NULL)
        return ERROR;
    return fail(it, "fmi3SetTime: cannot set the time %.9g s: this FMU is for co-simulation, in which doStep advances "
                    "the time; to go back, restore an FMU state that was kept, or reset the FMU, which begins at 0 s "
                    "again",
                time);
}

/* Their first argument is the name of the instance. */
EXPORT instance *fmi3InstantiateModelExchange(const char *name) { return (void)name, NULL; }
EXPORT instance *fmi3InstantiateScheduledExecution(const char *name) { return (void)name, NULL; }
#endif
