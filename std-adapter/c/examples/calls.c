/* Makes a call many times, and prints the processor time of each: calls ADDRESS COUNT read|write|pose|joints */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
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

int main(int argc, char **argv) {
    bcap_controller cell;
    struct timespec began, ended;
    if (argc < 4)
        return 2;
    const long count = atol(argv[2]);
    bcap_status status = bcap_connect(argv[1], BCAP_RC8, &cell);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &began);
    for (long made = 0; made < count && status == BCAP_OK; made++)
        status = call(cell, *argv[3]);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &ended);
    const double seconds = (double)(ended.tv_sec - began.tv_sec) + (double)(ended.tv_nsec - began.tv_nsec) / 1e9;
    printf("%.2f\n", seconds * 1e6 / (double)count);
    bcap_close(cell);
    return status != BCAP_OK;
}
