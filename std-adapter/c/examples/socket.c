/* The sans-IO client over a socket, as a board would use it over its own network: socket 127.0.0.1 5007 */
#include <arpa/inet.h>
#include <errno.h>
#include <inttypes.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "bcap.h"

static uint64_t now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
}

/* Makes one call over a stream, and waits for its reply. */
static bcap_status call(int link, bcap_client *client, int32_t function, const bcap_value *arguments, size_t count,
                        bcap_value *value) {
    bcap_status status = bcap_client_start(client, function, arguments, count, now_us());
    bcap_status lost = BCAP_E_CLOSED; /* the status if the link is lost: the controller has not got the call */
    while (status == BCAP_OK) {
        const uint8_t *bytes;
        uint8_t *room;
        size_t size;
        uint64_t deadline;
        bcap_event event;
        bcap_client_transmit(client, &bytes, &size);
        if (size > 0) {
            ssize_t sent = write(link, bytes, size);
            if (sent < 0 && errno != EINTR)
                return lost;
            if (sent > 0)
                lost = BCAP_E_LOST; /* the controller may have executed it */
            bcap_client_transmitted(client, sent > 0 ? (size_t)sent : 0);
            continue;
        }
        bcap_client_deadline(client, &deadline);
        uint64_t now = now_us();
        struct pollfd readable = {.fd = link, .events = POLLIN};
        if (poll(&readable, 1, deadline > now ? (int)((deadline - now) / 1000 + 1) : 0) > 0) {
            bcap_client_receive_buffer(client, &room, &size);
            ssize_t received = read(link, room, size);
            if (received == 0 || (received < 0 && errno != EINTR))
                return lost;
            bcap_client_received(client, received > 0 ? (size_t)received : 0);
        }
        do {
            status = bcap_client_poll(client, now_us(), &event);
            if (event.kind == BCAP_EVENT_FAILED || (event.kind == BCAP_EVENT_REPLIED && event.status != BCAP_OK))
                return event.status;
            if (event.kind == BCAP_EVENT_REPLIED)
                return bcap_client_value(client, value);
        } while (event.kind != BCAP_EVENT_NONE);
    }
    return status;
}

int main(int argc, char **argv) {
    static bcap_client client;
    static uint8_t tx[512], rx[512];
    signal(SIGPIPE, SIG_IGN); /* a lost link is an error of write */
    struct sockaddr_in peer = {.sin_family = AF_INET};
    peer.sin_port = htons((uint16_t)atoi(argc > 2 ? argv[2] : "5007"));
    inet_pton(AF_INET, argc > 1 ? argv[1] : "127.0.0.1", &peer.sin_addr);
    int link = socket(AF_INET, SOCK_STREAM, 0);
    if (connect(link, (struct sockaddr *)&peer, sizeof peer) != 0) {
        perror("connect");
        return 1;
    }

    bcap_value value;
    int64_t controller, variable, i1 = 0;
    bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx);
    const bcap_value start[] = {bcap_text("WDT=400")};
    bcap_status status = call(link, &client, BCAP_FN_SERVICE_START, start, 1, &value);
    const bcap_value open[] = {bcap_text(""), bcap_text("CaoProv.DENSO.VRC"), bcap_text("localhost"), bcap_text("")};
    if (status == BCAP_OK)
        status = call(link, &client, BCAP_FN_CONTROLLER_CONNECT, open, 4, &value);
    if (status == BCAP_OK)
        status = bcap_value_integer(&value, &controller);
    if (status == BCAP_OK) {
        const bcap_value get[] = {bcap_i4((int32_t)controller), bcap_text("I1"), bcap_text("")};
        status = call(link, &client, BCAP_FN_CONTROLLER_GET_VARIABLE, get, 3, &value);
    }
    if (status == BCAP_OK)
        status = bcap_value_integer(&value, &variable);
    if (status == BCAP_OK) {
        const bcap_value read = bcap_i4((int32_t)variable);
        status = call(link, &client, BCAP_FN_VARIABLE_GET_VALUE, &read, 1, &value);
    }
    if (status == BCAP_OK)
        status = bcap_value_integer(&value, &i1);

    char text[200];
    bcap_status_text(status, text, sizeof text);
    if (status == BCAP_OK)
        printf("I1 = %" PRId64 "\n", i1);
    else
        fprintf(stderr, "%s\n", text);
    close(link); /* the controller releases the objects */
    return status != BCAP_OK;
}
