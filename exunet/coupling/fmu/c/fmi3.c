/* FMI 3.0 for co-simulation, as its standard describes the functions; the declarations are our own. */
#include "instance.h"

#include <stdbool.h>
#include <stdint.h>

#define EXPORT __attribute__((visibility("default")))

typedef void logger3(void *environment, int status, const char *category, const char *message);

static void tell(instance *it, enum status status, const char *text)
{
    if (it->logger != NULL)
        ((logger3 *)it->logger)(it->environment, status, status == DISCARD ? "logStatusDiscard" : "logStatusError",
                                text);
}

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT int fmi3SetDebugLogging(instance *it, bool on, size_t number, const char *const categories[])
{
    (void)on, (void)number, (void)categories; /* only errors are told */
    return it == NULL ? ERROR : OK;
}

EXPORT instance *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                             bool logging, bool event_mode, bool early_return,
                                             const unsigned intermediate[], size_t number, void *environment,
                                             logger3 *logger, void (*update)(void))
{
    (void)visible, (void)logging, (void)event_mode, (void)early_return, (void)intermediate, (void)number, (void)update;
    return instance_new(name, token, resources, tell, environment, (void (*)(void))logger);
}

EXPORT void fmi3FreeInstance(instance *it) { instance_free(it); }

EXPORT int fmi3EnterInitializationMode(instance *it, bool has_tolerance, double tolerance, double start, bool has_stop,
                                       double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop; /* the case says how accurate it is */
    return check_start(it, start) != OK ? ERROR : (int)enter_initialisation(it);
}

EXPORT int fmi3ExitInitializationMode(instance *it) { return exit_initialisation(it); }
EXPORT int fmi3Terminate(instance *it) { return terminate(it); }
EXPORT int fmi3Reset(instance *it) { return reset(it); }

EXPORT int fmi3GetFloat64(instance *it, const unsigned reference[], size_t number, double value[], size_t values)
{
    if (it != NULL && number != values)
        return fail(it, "fmi3GetFloat64: %zu variables have %zu values", number, values);
    return get(it, reference, number, NUMBER, value);
}

EXPORT int fmi3SetFloat64(instance *it, const unsigned reference[], size_t number, const double value[], size_t values)
{
    if (it != NULL && number != values)
        return fail(it, "fmi3SetFloat64: %zu variables have %zu values", number, values);
    return set(it, reference, number, NUMBER, value);
}

EXPORT int fmi3GetBoolean(instance *it, const unsigned reference[], size_t number, bool value[], size_t values)
{
    size_t k;
    double one;

    if (it != NULL && number != values)
        return fail(it, "fmi3GetBoolean: %zu variables have %zu values", number, values);
    for (k = 0; k < number; k++) {
        if (get(it, reference + k, 1, SWITCH, &one) != OK)
            return ERROR;
        value[k] = one != 0.0;
    }
    return it == NULL ? ERROR : OK;
}

EXPORT int fmi3SetBoolean(instance *it, const unsigned reference[], size_t number, const bool value[], size_t values)
{
    size_t k;

    if (it != NULL && number != values)
        return fail(it, "fmi3SetBoolean: %zu variables have %zu values", number, values);
    for (k = 0; k < number; k++) {
        const double one = value[k];
        if (set(it, reference + k, 1, SWITCH, &one) != OK)
            return ERROR;
    }
    return it == NULL ? ERROR : OK;
}

EXPORT int fmi3GetFMUState(instance *it, void **place) { return keep(it, place); }
EXPORT int fmi3SetFMUState(instance *it, void *kept) { return restore(it, kept); }
EXPORT int fmi3FreeFMUState(instance *it, void **place) { return forget(it, place); }
EXPORT int fmi3SerializedFMUStateSize(instance *it, void *kept, size_t *size) { return packed_size(it, kept, size); }

EXPORT int fmi3SerializeFMUState(instance *it, void *kept, uint8_t bytes[], size_t size)
{
    return pack(it, kept, (char *)bytes, size);
}

EXPORT int fmi3DeserializeFMUState(instance *it, const uint8_t bytes[], size_t size, void **place)
{
    return unpack(it, (const char *)bytes, size, place);
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

/* Functions for variables, modes and kinds of FMU that there are not here. Hosts call them with more arguments
 * than they are declared with, which the C calling conventions of Linux allow: the caller clears the stack. */
#define ABSENT(name) \
    EXPORT int name(instance *it) { return refuse(it, #name); }
/* The same where asking for no variable at all is right. */
#define NO_VARIABLES(name)                                                    \
    EXPORT int name(instance *it, const unsigned reference[], size_t number)  \
    {                                                                         \
        (void)reference;                                                      \
        return number == 0 && it != NULL ? OK : (int)refuse(it, #name);       \
    }
NO_VARIABLES(fmi3GetFloat32)
NO_VARIABLES(fmi3GetInt8)
NO_VARIABLES(fmi3GetUInt8)
NO_VARIABLES(fmi3GetInt16)
NO_VARIABLES(fmi3GetUInt16)
NO_VARIABLES(fmi3GetInt32)
NO_VARIABLES(fmi3GetUInt32)
NO_VARIABLES(fmi3GetInt64)
NO_VARIABLES(fmi3GetUInt64)
NO_VARIABLES(fmi3GetString)
NO_VARIABLES(fmi3GetBinary)
NO_VARIABLES(fmi3GetClock)
NO_VARIABLES(fmi3SetFloat32)
NO_VARIABLES(fmi3SetInt8)
NO_VARIABLES(fmi3SetUInt8)
NO_VARIABLES(fmi3SetInt16)
NO_VARIABLES(fmi3SetUInt16)
NO_VARIABLES(fmi3SetInt32)
NO_VARIABLES(fmi3SetUInt32)
NO_VARIABLES(fmi3SetInt64)
NO_VARIABLES(fmi3SetUInt64)
NO_VARIABLES(fmi3SetString)
NO_VARIABLES(fmi3SetBinary)
NO_VARIABLES(fmi3SetClock)

ABSENT(fmi3EnterConfigurationMode)
ABSENT(fmi3ExitConfigurationMode)
ABSENT(fmi3EnterEventMode)
ABSENT(fmi3EnterStepMode)
ABSENT(fmi3EnterContinuousTimeMode)
ABSENT(fmi3GetNumberOfVariableDependencies)
ABSENT(fmi3GetVariableDependencies)
ABSENT(fmi3GetDirectionalDerivative)
ABSENT(fmi3GetAdjointDerivative)
ABSENT(fmi3GetIntervalDecimal)
ABSENT(fmi3GetIntervalFraction)
ABSENT(fmi3GetShiftDecimal)
ABSENT(fmi3GetShiftFraction)
ABSENT(fmi3SetIntervalDecimal)
ABSENT(fmi3SetIntervalFraction)
ABSENT(fmi3SetShiftDecimal)
ABSENT(fmi3SetShiftFraction)
ABSENT(fmi3EvaluateDiscreteStates)
ABSENT(fmi3UpdateDiscreteStates)
ABSENT(fmi3CompletedIntegratorStep)
ABSENT(fmi3SetContinuousStates)
ABSENT(fmi3GetContinuousStateDerivatives)
ABSENT(fmi3GetEventIndicators)
ABSENT(fmi3GetContinuousStates)
ABSENT(fmi3GetNominalsOfContinuousStates)
ABSENT(fmi3GetNumberOfEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates)
ABSENT(fmi3GetOutputDerivatives)
ABSENT(fmi3ActivateModelPartition)

/* Hosts that take this one for a model that they integrate themselves. */
EXPORT int fmi3SetTime(instance *it, double time)
{
    if (it == NULL)
        return ERROR;
    return fail(it, "fmi3SetTime: cannot set the time %.9g s: this FMU is for co-simulation, whose time doStep moves "
                    "on; to go back, restore an FMU state that was kept, or reset the FMU, which begins at 0 s again",
                time);
}

/* Their first argument is the name of the instance. */
EXPORT instance *fmi3InstantiateModelExchange(const char *name)
{
    (void)name;
    return NULL;
}

EXPORT instance *fmi3InstantiateScheduledExecution(const char *name)
{
    (void)name;
    return NULL;
}
