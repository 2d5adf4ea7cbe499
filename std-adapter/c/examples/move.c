/* Moves to P1 along a line at 10 % of the speed: move tcp:192.168.0.1 */
#include <stdio.h>
#include "bcap.h"

int main(int argc, char **argv) {
    const bcap_motion to_p1 = {.to = "P1", .line = true, .speed_percent = 10};
    bcap_controller cell;
    bcap_status status = bcap_connect(argc > 1 ? argv[1] : "tcp:127.0.0.1", BCAP_RC8, &cell);
    if (status == BCAP_OK)
        status = bcap_take_arm(cell);
    if (status == BCAP_OK)
        status = bcap_motor(cell, true);
    if (status == BCAP_OK)
        status = bcap_move(cell, &to_p1, 30000); /* halts the robot after 30 s */
    char text[256];
    if (status != BCAP_OK && bcap_message(text, sizeof text) > 0)
        fprintf(stderr, "not at P1: %s\n", text);
    bcap_close(cell); /* switches the motor off and gives the arm back */
    return status != BCAP_OK;
}
