/* An instance of the FMU, whichever version of FMI the host speaks. */
#ifndef EXUNET_INSTANCE_H
#define EXUNET_INSTANCE_H

#include "table.h"
#include "worker.h"

/* As both versions number them. */
enum status { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 };

enum mode { INSTANTIATED, INITIALISING, STEPPING, TERMINATED };

enum kind { NUMBER = 'n', SWITCH = 's' };

typedef struct instance instance;

/* Tell the host what is wrong. */
typedef void teller(instance *it, enum status status, const char *text);

struct instance {
    uint64_t identity;     /* no other instance of the process has it, nor had */
    char *name;
    char *resources;
    teller *tell;
    void *environment;     /* of the host's logger */
    void (*logger)(void);  /* the host's; `tell` knows its type */
    worker worker;
    unsigned long workers; /* how many there have been */
    enum mode mode;
    int stopped;           /* after an error, until the host restores a state or resets */
    int built;             /* the worker has a net for these values */
    double time;
    double stop; /* that the host gave, or infinity */
    double values[VARIABLES];
};

/* A state that the host keeps. */
typedef struct {
    uint64_t identity;    /* of the instance */
    unsigned long worker; /* that has the net's part of it */
    uint64_t number;      /* by which that knows it */
    char *bytes;          /* packed, once asked for */
    size_t size;
    double side[4 + VARIABLES]; /* mode, built, time, stop, values */
} state;

/* NULL if it cannot be made, after the host was told why. */
instance *instance_new(const char *name, const char *token, const char *resources, teller *tell, void *environment,
                       void (*logger)(void));
void instance_free(instance *it);

enum status fail(instance *it, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Values by reference; `kind` is that of the function that the host calls. */
enum status get(instance *it, const unsigned *reference, size_t number, enum kind kind, double *values);
enum status set(instance *it, const unsigned *reference, size_t number, enum kind kind, const double *values);

/* Check the start time, and set the stop time if there is one. */
enum status set_times(instance *it, double start, int has_stop, double stop);
enum status enter_initialisation(instance *it);
enum status exit_initialisation(instance *it);
enum status step(instance *it, double begin, double length);
enum status terminate(instance *it);
enum status reset(instance *it);

enum status keep(instance *it, void **place);
enum status restore(instance *it, void *kept);
enum status forget(instance *it, void **place);
enum status packed_size(instance *it, void *kept, size_t *size);
enum status pack(instance *it, void *kept, char *bytes, size_t size);
enum status unpack(instance *it, const char *bytes, size_t size, void **place);

/* For functions that belong to other kinds of FMU. */
enum status refuse(instance *it, const char *function);

#endif
