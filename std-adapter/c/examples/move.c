/* Moves to P1 along a line at 10 % of the speed: move tcp:192.168.0.1 */
#include <stdio.h>
#include "bcap.h"

static int failed(bcap_status status, const char *problem) {
    char text[256] = "";
    if (status != BCAP_OK && bcap_message(text, sizeof text) > 0)
        fprintf(stderr, "%s: %s\n", problem, text);
    return status != BCAP_OK;
}

int main(int argc, char **argv) {
    const bcap_motion to_p1 = {.to = "P1", .line = true, .speed_percent = 10};
    bcap_controller cell;
    if (failed(bcap_connect(argc > 1 ? argv[1] : "tcp:127.0.0.1", BCAP_RC8, &cell), "not connected"))
        return 1;
    if (failed(bcap_take_arm(cell), "no arm"))
        return 1;
    bcap_status status = bcap_motor(cell, true);
    if (status == BCAP_OK)
        status = bcap_move(cell, &to_p1, 30000); /* halts the robot after 30 s */
    int code = failed(status, "not at P1");
    code |= failed(bcap_give_arm(cell), "the motor may be on"); /* switches the motor off */
    return failed(bcap_close(cell), "not closed") | code;
}
