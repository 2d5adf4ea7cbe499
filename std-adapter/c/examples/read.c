/* Reads and writes a variable: read tcp:192.168.0.1 */
#include <inttypes.h>
#include <stdio.h>
#include "bcap.h"

static int failed(bcap_status status) {
    char text[256] = "";
    if (status != BCAP_OK && bcap_message(text, sizeof text) > 0)
        fprintf(stderr, "%s\n", text);
    return status != BCAP_OK;
}

int main(int argc, char **argv) {
    bcap_controller cell;
    int64_t count = 0;
    if (failed(bcap_connect(argc > 1 ? argv[1] : "tcp:127.0.0.1", BCAP_RC8, &cell)))
        return 1;
    bcap_status status = bcap_read_integer(cell, "I1", &count);
    if (status == BCAP_OK)
        status = bcap_write(cell, "I1", bcap_i4((int32_t)count + 1));
    if (status == BCAP_OK)
        printf("I1 was %" PRId64 "\n", count);
    int code = failed(status);
    return failed(bcap_close(cell)) || code;
}
