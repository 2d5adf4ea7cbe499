/* Reads I1 many times, and prints the calls a second and the processor time of each: calls ADDRESS COUNT */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "bcap.h"

static double seconds(clockid_t clock) {
    struct timespec now;
    clock_gettime(clock, &now);
    return (double)now.tv_sec + (double)now.tv_nsec / 1e9;
}

int main(int argc, char **argv) {
    bcap_controller cell;
    int64_t value;
    const long count = argc > 2 ? atol(argv[2]) : 10000;
    bcap_status status = bcap_connect(argc > 1 ? argv[1] : "tcp:127.0.0.1", BCAP_RC8, &cell);
    const double began = seconds(CLOCK_MONOTONIC), used = seconds(CLOCK_PROCESS_CPUTIME_ID);
    for (long call = 0; call < count && status == BCAP_OK; call++)
        status = bcap_read_integer(cell, "I1", &value);
    printf("C:    %.0f calls/s, %.2f us of processor time each\n", (double)count / (seconds(CLOCK_MONOTONIC) - began),
           (seconds(CLOCK_PROCESS_CPUTIME_ID) - used) * 1e6 / (double)count);
    bcap_close(cell);
    return status != BCAP_OK;
}
