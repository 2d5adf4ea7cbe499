/* Makes the calls of each line of stdin, such as "read 500", and prints the processor time and the time of each in microseconds:
 * calls ADDRESS. The calls are read, write, pose and joints. */
#include <stdio.h>
#include <sys/resource.h>
#include <time.h>

#include "bcap.h"

static bcap_status call(bcap_controller cell, char operation) {
    double numbers[8];
    size_t count;
    int64_t integer;
    switch (operation) {
    case 'w': return bcap_write(cell, "I1", bcap_i4(5));
    case 'p': return bcap_read_numbers(cell, "P1", numbers, 8, &count);
    case 'j': return bcap_joints(cell, numbers);
    default: return bcap_read_integer(cell, "I1", &integer);
    }
}

static double processor_us(void) {
    struct rusage used;
    getrusage(RUSAGE_SELF, &used);
    return (double)(used.ru_utime.tv_sec + used.ru_stime.tv_sec) * 1e6 + (double)(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
}

static double now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec * 1e6 + (double)now.tv_nsec / 1e3;
}

int main(int argc, char **argv) {
    bcap_controller cell;
    char operation[16];
    long count;
    bcap_status status = bcap_connect(argc > 1 ? argv[1] : "tcp:127.0.0.1", BCAP_RC8, &cell);
    while (status == BCAP_OK && scanf("%15s %ld", operation, &count) == 2) {
        const double processor = processor_us(), began = now_us();
        for (long made = 0; made < count && status == BCAP_OK; made++)
            status = call(cell, operation[0]);
        printf("%.3f %.3f\n", (processor_us() - processor) / (double)count, (now_us() - began) / (double)count);
        fflush(stdout);
    }
    bcap_close(cell);
    return status != BCAP_OK;
}
