/* Makes the calls of each line of stdin, such as "read 50", and prints the processor time and the time of each in microseconds:
 * calls ADDRESS. The calls are read, write, pose and joints. The first ones fill the caches. */
#include <stdio.h>
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
        for (long made = 0; made < count / 5 && status == BCAP_OK; made++)
            status = call(cell, operation[0]);
        const clock_t processor = clock();
        const double began = now_us();
        for (long made = 0; made < count && status == BCAP_OK; made++)
            status = call(cell, operation[0]);
        const double used = (double)(clock() - processor) * 1e6 / CLOCKS_PER_SEC;
        printf("%.3f %.3f\n", used / (double)count, (now_us() - began) / (double)count);
        fflush(stdout);
    }
    bcap_close(cell);
    return status != BCAP_OK;
}
