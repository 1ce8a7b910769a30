/* A process beside the host's: it has the net, and answers requests over a socket. */
#ifndef EXUNET_WORKER_H
#define EXUNET_WORKER_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

/* What is asked; exunet/coupling/fmu/worker.py has the same order. */
enum request { BUILD, STEP, KEEP, RESTORE, FREE, PACK, UNPACK };

/* How a request ended; BROKEN: the worker is gone, `text` says how. */
enum answer { DONE = 0, FAILED = 1, STOPPED = 2, BROKEN = 3 };

typedef struct {
    const void *data;
    size_t size;
} part;

typedef struct {
    pid_t process; /* 0: there is none */
    int socket;
    char *reply; /* of the last answer, `size` bytes and a zero */
    size_t size, room;
    char text[512]; /* why it is gone */
} worker;

/* Start one with the folder "resources" of the FMU, and wait until it says `token`. */
enum answer worker_start(worker *it, const char *resources, const char *token);

/* Ask it; what it says is in `reply`. */
enum answer worker_ask(worker *it, enum request what, const part *parts, int number);

/* End it and free what it holds; it may be gone already. */
void worker_end(worker *it);

/* The text that belongs to an answer other than DONE. */
const char *worker_words(const worker *it, enum answer answer);

#endif
