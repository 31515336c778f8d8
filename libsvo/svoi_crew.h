/* Threads that stay for the next loop. Creating one costs 20 microseconds, and much more where it follows the end of another: the system places a new thread
 * while the one that has just ended still seems to use the other processor, and moves it there milliseconds later. */
#ifndef SVOI_CREW_H
#define SVOI_CREW_H

#include <stdbool.h>

/* What a thread does; it lives from svoi_crew_start to the end of svoi_crew_wait. */
typedef struct svoi_order {
    void (*fn)(void *arg);
    void *arg;
    bool done; /* guarded by the crew's lock */
} svoi_order;

/* Have fn(arg) run by another thread, one that waits or a new one; false where none can be had: nothing is run then. Any thread may call it,
 * one that runs an order too. */
bool svoi_crew_start(svoi_order *order);
/* Until it is done. */
void svoi_crew_wait(svoi_order *order);

#endif
