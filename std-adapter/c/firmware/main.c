/* Reads I1 of a robot over a serial line, and prints it on the console. No heap: 1 KiB of buffers. */
#include "bcap.h"
#include "board.h"

enum { ROBOT = 0, CONSOLE = 1 };

static bcap_client client;
static uint8_t tx[512], rx[512];

static void print(const char *text) {
    for (; *text != 0; text++)
        while (!uart_write(CONSOLE, (uint8_t)*text)) {
        }
}

static void print_number(int64_t number) {
    char digits[20];
    int count = 0;
    uint32_t rest = number < 0 ? 0u - (uint32_t)number : (uint32_t)number;
    if (number < 0)
        print("-");
    do
        digits[count++] = (char)('0' + rest % 10);
    while ((rest /= 10) != 0);
    while (count > 0) {
        const char digit[] = {digits[--count], 0};
        print(digit);
    }
}

/* Moves bytes between the line and the client. */
static void move_bytes(void) {
    const uint8_t *bytes;
    uint8_t *room;
    size_t count, received = 0;
    bcap_client_transmit(&client, &bytes, &count);
    if (count > 0 && uart_write(ROBOT, bytes[0]))
        bcap_client_transmitted(&client, 1);
    bcap_client_receive_buffer(&client, &room, &count);
    while (received < count && uart_read(ROBOT, &room[received]))
        received++;
    bcap_client_received(&client, received);
}

/* Makes one call, and waits for its reply. */
static bcap_status call(int32_t function, const bcap_value *arguments, size_t count, int64_t *result) {
    bcap_event event = {BCAP_EVENT_NONE, BCAP_OK};
    bcap_value value;
    bcap_status status = bcap_client_start(&client, function, arguments, count, now_us());
    while (status == BCAP_OK && event.kind != BCAP_EVENT_REPLIED && event.kind != BCAP_EVENT_FAILED) {
        move_bytes();
        status = bcap_client_poll(&client, now_us(), &event);
    }
    if (status == BCAP_OK)
        status = event.status;
    if (status == BCAP_OK)
        status = bcap_client_value(&client, &value);
    return status == BCAP_OK && result != 0 ? bcap_value_integer(&value, result) : status;
}

static bcap_status read_i1(int64_t *i1) {
    int64_t controller = 0, variable = 0;
    const bcap_value start[] = {bcap_text("WDT=400")};
    bcap_status status = call(BCAP_FN_SERVICE_START, start, 1, 0);
    if (status != BCAP_OK)
        return status;
    const bcap_value open[] = {bcap_text(""), bcap_text("CaoProv.DENSO.VRC"), bcap_text("localhost"), bcap_text("")};
    status = call(BCAP_FN_CONTROLLER_CONNECT, open, 4, &controller);
    if (status != BCAP_OK)
        return status;
    const bcap_value get[] = {bcap_i4((int32_t)controller), bcap_text("I1"), bcap_text("")};
    status = call(BCAP_FN_CONTROLLER_GET_VARIABLE, get, 3, &variable);
    if (status != BCAP_OK)
        return status;
    const bcap_value handle = bcap_i4((int32_t)variable);
    return call(BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, i1);
}

static void program(void) {
    int64_t i1 = 0;
    uart_start(ROBOT);
    uart_start(CONSOLE);
    bcap_status status = bcap_client_init(&client, BCAP_LINK_SERIAL, tx, sizeof tx, rx, sizeof rx);
    if (status == BCAP_OK)
        status = read_i1(&i1);
    print(status == BCAP_OK ? "I1 = " : "cannot read I1: status ");
    print_number(status == BCAP_OK ? i1 : status);
    print("\n");
    leave(status != BCAP_OK);
}

extern uint32_t stack_top;

void reset(void) {
    board_start();
    program();
    leave(0);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, tick,
};
