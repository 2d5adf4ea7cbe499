/* Tests of the sans-IO client, of values and of lines of RAC: no network, and no function of the hosted client. */
#define SANS_IO
#include "check.h"

static uint8_t tx[512], rx[512];

/* Little-endian bytes of a reply without a retransmission: header, one argument, EOT. */
static size_t reply(uint8_t *frame, uint16_t serial, int32_t result, const uint8_t *value, uint32_t length) {
    uint32_t argument = length == 0 ? 0 : 4 + length;
    uint32_t total = 15 + argument + 1;
    const uint8_t header[15] = {1,
                                (uint8_t)total, (uint8_t)(total >> 8), (uint8_t)(total >> 16), (uint8_t)(total >> 24),
                                (uint8_t)serial, (uint8_t)(serial >> 8), 0, 0,
                                (uint8_t)result, (uint8_t)(result >> 8), (uint8_t)(result >> 16), (uint8_t)((uint32_t)result >> 24),
                                length != 0, 0};
    memcpy(frame, header, sizeof header);
    if (length != 0) {
        const uint8_t count[4] = {(uint8_t)length, (uint8_t)(length >> 8), (uint8_t)(length >> 16), (uint8_t)(length >> 24)};
        memcpy(frame + 15, count, 4);
        memcpy(frame + 19, value, length);
    }
    frame[total - 1] = 4;
    return total;
}

/* Sends the request of a client to nowhere. */
static void send_all(bcap_client *client) {
    const uint8_t *bytes;
    size_t count;
    OK(bcap_client_transmit(client, &bytes, &count));
    CHECK(count > 0 && bytes[0] == 1 && bytes[count - 1] == 4);
    OK(bcap_client_transmitted(client, count));
    OK(bcap_client_transmit(client, &bytes, &count));
    CHECK(count == 0);
}

static void receive(bcap_client *client, const uint8_t *frame, size_t length) {
    uint8_t *room;
    size_t size;
    OK(bcap_client_receive_buffer(client, &room, &size));
    CHECK(size >= length);
    memcpy(room, frame, length);
    OK(bcap_client_received(client, length));
}

static bcap_event poll_at(bcap_client *client, uint64_t now) {
    bcap_event event;
    OK(bcap_client_poll(client, now, &event));
    return event;
}

/* Starts Variable_GetValue of handle 3, and answers with a value. */
static bcap_value exchange(bcap_client *client, uint16_t serial, const uint8_t *encoded, uint32_t length) {
    uint8_t frame[512];
    const bcap_value handle = bcap_i4(3);
    bcap_value value;
    OK(bcap_client_start(client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    send_all(client);
    receive(client, frame, reply(frame, serial, 0, encoded, length));
    bcap_event event = poll_at(client, 0);
    CHECK(event.kind == BCAP_EVENT_REPLIED && event.status == BCAP_OK);
    OK(bcap_client_value(client, &value));
    return value;
}

static void calls(void) {
    static bcap_client client;
    const uint8_t seven[10] = {3, 0, 1, 0, 0, 0, 7, 0, 0, 0};
    uint8_t frame[64];
    int64_t integer;
    uint64_t at;
    OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx));
    OK(bcap_client_deadline(&client, &at));
    CHECK(at == UINT64_MAX);
    bcap_value value = exchange(&client, 1, seven, sizeof seven);
    CHECK(value.type == BCAP_I4 && value.count == 1);
    OK(bcap_value_integer(&value, &integer));
    CHECK(integer == 7);

    /* a refusal is the code of the controller */
    const bcap_value handle = bcap_i4(3);
    OK(bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    STATUS(BCAP_E_BUSY, bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    STATUS(BCAP_E_NO_REPLY, bcap_client_value(&client, &value));
    send_all(&client);
    receive(&client, frame, reply(frame, 2, (int32_t)0x80000204u, NULL, 0));
    bcap_event event = poll_at(&client, 0);
    CHECK(event.kind == BCAP_EVENT_REPLIED && event.status == (int32_t)0x80000204u);
    char text[128];
    CHECK(bcap_status_text(event.status, text, sizeof text) > 0);
    CHECK(strstr(text, "0x80000204: E_CAO_OBJECT_NOTFOUND") == text);

    /* a timeout; an abandoned call; a reply that belongs to no call */
    OK(bcap_client_set_timing(&client, 100, 1, 1000));
    OK(bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    OK(bcap_client_deadline(&client, &at));
    CHECK(at == 100000);
    send_all(&client);
    CHECK(poll_at(&client, 99999).kind == BCAP_EVENT_NONE);
    event = poll_at(&client, 100000);
    CHECK(event.kind == BCAP_EVENT_FAILED && event.status == BCAP_E_TIMEOUT);
    receive(&client, frame, reply(frame, 3, 0, seven, sizeof seven));
    CHECK(poll_at(&client, 100000).kind == BCAP_EVENT_DROPPED);
    OK(bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    OK(bcap_client_abandon(&client));
    OK(bcap_client_reset(&client));

    /* invalid bytes end a stream */
    OK(bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    send_all(&client);
    receive(&client, (const uint8_t *)"HTTP/1.1 400 Bad Request", 24);
    event = poll_at(&client, 0);
    CHECK(event.kind == BCAP_EVENT_FAILED && event.status == BCAP_E_MALFORMED);
    STATUS(BCAP_E_CLOSED, bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    OK(bcap_client_reset(&client));

    /* over UDP a retransmission has another serial */
    OK(bcap_client_init(&client, BCAP_LINK_DATAGRAM, tx, sizeof tx, rx, sizeof rx));
    OK(bcap_client_set_serial(&client, 500));
    OK(bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    send_all(&client);
    CHECK(poll_at(&client, 500000).kind == BCAP_EVENT_RETRIED);
    send_all(&client);
    receive(&client, frame, reply(frame, 501, 0x900, NULL, 0));
    CHECK(poll_at(&client, 500000).kind == BCAP_EVENT_EXECUTING);
    receive(&client, frame, reply(frame, 500, 0, seven, sizeof seven));
    CHECK(poll_at(&client, 500000).kind == BCAP_EVENT_REPLIED);

    /* calls and replies that do not fit */
    OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, 20, rx, 24));
    STATUS(BCAP_E_TOO_LARGE, bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, 24));
    OK(bcap_client_start(&client, BCAP_FN_VARIABLE_GET_VALUE, &handle, 1, 0));
    send_all(&client);
    size_t length = reply(frame, 1, 0, seven, sizeof seven);
    receive(&client, frame, 24);
    event = poll_at(&client, 0);
    CHECK(length == 30 && event.kind == BCAP_EVENT_FAILED && event.status == BCAP_E_REPLY_TOO_LARGE);
}

static void values(void) {
    static bcap_client client;
    OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx));
    bcap_value value, element;
    int64_t integer;
    double number, numbers[8];
    size_t count;
    char text[16];

    /* BSTR "Aé", also with a shorter buffer */
    const uint8_t string[] = {8, 0, 1, 0, 0, 0, 4, 0, 0, 0, 'A', 0, 0xe9, 0};
    value = exchange(&client, 1, string, sizeof string);
    CHECK(value.type == BCAP_BSTR);
    OK(bcap_value_text(&value, text, sizeof text));
    CHECK(strcmp(text, "A\xc3\xa9") == 0);
    memset(text, 'x', sizeof text);
    STATUS(BCAP_E_SHORT, bcap_value_text(&value, text, 3));
    CHECK(strcmp(text, "A") == 0 && text[3] == 'x');
    STATUS(BCAP_E_SHORT, bcap_value_text(&value, NULL, 0));
    STATUS(BCAP_E_TYPE, bcap_value_integer(&value, &integer));
    STATUS(BCAP_E_TYPE, bcap_value_element(&value, 0, &element));

    /* an array of R4, and the same array again as an argument */
    const uint8_t floats[] = {4, 32, 2, 0, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0};
    value = exchange(&client, 2, floats, sizeof floats);
    CHECK(value.type == (BCAP_ARRAY | BCAP_R4) && value.count == 2);
    OK(bcap_value_numbers(&value, numbers, 8, &count));
    CHECK(count == 2 && numbers[0] == 1.0 && numbers[1] == -2.0);
    OK(bcap_value_numbers(&value, numbers, 2, NULL));
    STATUS(BCAP_E_SHORT, bcap_value_numbers(&value, numbers, 1, &count));
    OK(bcap_value_element(&value, 1, &element));
    OK(bcap_value_number(&element, &number));
    CHECK(element.type == BCAP_R4 && number == -2.0);
    STATUS(BCAP_E_RANGE, bcap_value_element(&value, 2, &element));
    CHECK(bcap_value_integer(&value, &integer) == BCAP_E_TYPE);

    /* VARIANTs in an array: [I4[7], "x"] */
    const uint8_t nested[] = {12, 32, 2, 0, 0, 0, 3, 32, 1, 0, 0, 0, 7, 0, 0, 0, 8, 0, 1, 0, 0, 0, 2, 0, 0, 0, 'x', 0};
    value = exchange(&client, 3, nested, sizeof nested);
    OK(bcap_value_element(&value, 0, &element));
    CHECK(element.type == (BCAP_ARRAY | BCAP_I4));
    bcap_value inner;
    OK(bcap_value_element(&element, 0, &inner));
    OK(bcap_value_integer(&inner, &integer));
    CHECK(integer == 7);
    OK(bcap_value_element(&value, 1, &element));
    OK(bcap_value_text(&element, text, sizeof text));
    CHECK(strcmp(text, "x") == 0);
    STATUS(BCAP_E_TYPE, bcap_value_numbers(&value, numbers, 8, &count));

    /* a view whose memory has changed is refused */
    memset(rx, 0xff, sizeof rx);
    STATUS(BCAP_E_VALUE, bcap_value_element(&value, 0, &element));
}

/* Returns the bytes of the arguments of a request. */
static const uint8_t *encoded(const bcap_value *arguments, size_t count, size_t *length) {
    static bcap_client client;
    const uint8_t *bytes;
    OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx));
    OK(bcap_client_start(&client, BCAP_FN_ROBOT_MOVE, arguments, count, 0));
    OK(bcap_client_transmit(&client, &bytes, length));
    *length -= 16;
    return bytes + 15;
}

static bcap_status refused(bcap_value value) {
    static bcap_client client;
    OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx));
    return bcap_client_start(&client, BCAP_FN_ROBOT_MOVE, &value, 1, 0);
}

static void arguments(void) {
    const float pose[2] = {1, -2};
    const bcap_value parts[] = {bcap_array(BCAP_R4, pose, 2), bcap_i4(2), bcap_text("P")};
    const bcap_value all[] = {bcap_list(parts, 3), bcap_bool(true), bcap_r8(0.5), bcap_empty(), bcap_integer(BCAP_UI2, 65535)};
    const uint8_t wanted[] = {
        /* [R4[1, -2], I4 2, "P"] */
        42, 0, 0, 0, 12, 32, 3, 0, 0, 0, 4, 32, 2, 0, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0, 3, 0, 1, 0, 0, 0, 2, 0, 0,
        0, 8, 0, 1, 0, 0, 0, 2, 0, 0, 0, 'P', 0,
        /* BOOL, R8 0.5, EMPTY, UI2 65535 */
        8, 0, 0, 0, 11, 0, 1, 0, 0, 0, 0xff, 0xff, 14, 0, 0, 0, 5, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xe0, 0x3f, 6, 0, 0,
        0, 0, 0, 1, 0, 0, 0, 8, 0, 0, 0, 18, 0, 1, 0, 0, 0, 0xff, 0xff};
    size_t length;
    const uint8_t *found = encoded(all, 5, &length);
    CHECK(length == sizeof wanted && memcmp(found, wanted, length) == 0);

    /* a scalar and a text that were made are read back */
    const bcap_value number = bcap_r4(0.25f);
    double back;
    OK(bcap_value_number(&number, &back));
    CHECK(back == 0.25);
    const bcap_value truth = bcap_bool(true);
    int64_t one;
    OK(bcap_value_integer(&truth, &one));
    CHECK(one == 1);

    /* an integer of a floating-point type is converted */
    const uint16_t floats[] = {BCAP_R4, BCAP_R8, BCAP_DATE};
    for (int index = 0; index < 3; index++) {
        const bcap_value converted = bcap_integer(floats[index], 50);
        CHECK(converted.type == floats[index] && converted.data.number == 50);
    }
    const bcap_value speed = bcap_integer(BCAP_R4, 50);
    OK(bcap_value_number(&speed, &back));
    CHECK(back == 50);
    const uint8_t fifty[] = {10, 0, 0, 0, 4, 0, 1, 0, 0, 0, 0, 0, 0x48, 0x42};
    found = encoded(&speed, 1, &length);
    CHECK(length == sizeof fifty && memcmp(found, fifty, length) == 0);

    STATUS(BCAP_E_VALUE, refused(bcap_text(NULL)));
    STATUS(BCAP_E_VALUE, refused(bcap_text("\xff")));
    STATUS(BCAP_E_VALUE, refused(bcap_integer(BCAP_UI1, 256)));
    STATUS(BCAP_E_VALUE, refused(bcap_integer(BCAP_I2, -40000)));
    STATUS(BCAP_E_VALUE, refused(bcap_integer(77, 1)));
    STATUS(BCAP_E_VALUE, refused(bcap_array(BCAP_BSTR, pose, 1)));
    STATUS(BCAP_E_VALUE, refused(bcap_array(BCAP_R8, NULL, 1)));
    STATUS(BCAP_E_VALUE, refused(bcap_array(BCAP_R8, pose, SIZE_MAX)));
    STATUS(BCAP_E_VALUE, refused(bcap_list(NULL, 1)));
    STATUS(BCAP_E_TOO_LARGE, refused(bcap_array(BCAP_R8, rx, 64)));
    /* deeper than a VARIANT can be */
    bcap_value deep[20] = {bcap_i4(1)};
    for (int depth = 1; depth < 20; depth++)
        deep[depth] = bcap_list(&deep[depth - 1], 1);
    STATUS(BCAP_E_VALUE, refused(deep[19]));
    /* content that no function made */
    bcap_value garbage;
    memset(&garbage, 0xa5, sizeof garbage);
    STATUS(BCAP_E_VALUE, refused(garbage));
    CHECK(bcap_value_integer(&garbage, NULL) == BCAP_E_VALUE);
}

static void lines(void) {
    char line[256], text[16];
    size_t length;
    uint8_t memory[1024];
    bcap_value value = bcap_i4(123);
    OK(bcap_rac_get("I10", line, sizeof line, &length));
    CHECK(length == 14 && memcmp(line, "GET:RC8:10:I:\r", 14) == 0);
    OK(bcap_rac_put("I10", &value, line, sizeof line, &length));
    CHECK(memcmp(line, "PUT:RC8:10:I:3,123\r", length) == 0);
    value = bcap_text("abc");
    OK(bcap_rac_put("S1", &value, line, sizeof line, &length));
    CHECK(memcmp(line, "PUT:RC8:1:S:8,abc\r", length) == 0);
    STATUS(BCAP_E_SHORT, bcap_rac_get("I10", line, 5, &length));
    STATUS(BCAP_E_PATH, bcap_rac_get("X10", line, sizeof line, &length));
    STATUS(BCAP_E_POINTER, bcap_rac_get(NULL, line, sizeof line, &length));
    STATUS(BCAP_E_POINTER, bcap_rac_get("I10", NULL, sizeof line, &length));

    int64_t integer;
    OK(bcap_rac_reply("0,3,123", 7, memory, sizeof memory, &value));
    OK(bcap_value_integer(&value, &integer));
    CHECK(integer == 123);
    OK(bcap_rac_reply("0,8,Sample", 10, memory, sizeof memory, &value));
    OK(bcap_value_text(&value, text, sizeof text));
    CHECK(strcmp(text, "Sample") == 0);
    OK(bcap_rac_reply("0,8196,1,2.5", 12, memory, sizeof memory, &value));
    double numbers[2];
    OK(bcap_value_numbers(&value, numbers, 2, &length));
    CHECK(length == 2 && numbers[1] == 2.5);
    STATUS((int32_t)0x80070057, bcap_rac_reply("-2147024809", 11, memory, sizeof memory, &value));
    CHECK(value.type == BCAP_EMPTY);
    STATUS(BCAP_E_TEXT, bcap_rac_reply("nonsense", 8, memory, sizeof memory, &value));
    STATUS(BCAP_E_TEXT, bcap_rac_reply("0,8196,1,2.5", 12, memory, 8, &value));
    STATUS(BCAP_E_POINTER, bcap_rac_reply("0,3,1", 5, NULL, 0, &value));
}

static void misuse(void) {
    static bcap_client client, copy;
    bcap_value value = bcap_i4(1);
    bcap_event event;
    const uint8_t *bytes;
    uint8_t *room;
    size_t count;
    uint64_t at;

    /* null and misaligned pointers, buffers that overlap */
    STATUS(BCAP_E_POINTER, bcap_client_init(NULL, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx));
    STATUS(BCAP_E_POINTER, bcap_client_init((bcap_client *)((char *)&client + 1), BCAP_LINK_STREAM, tx, 512, rx, 512));
    STATUS(BCAP_E_POINTER, bcap_client_init(&client, BCAP_LINK_STREAM, NULL, 512, rx, sizeof rx));
    STATUS(BCAP_E_POINTER, bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, NULL, 0));
    STATUS(BCAP_E_POINTER, bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, tx + 500, 12));
    STATUS(BCAP_E_POINTER, bcap_client_init(&client, BCAP_LINK_STREAM, (uint8_t *)&client, 8, rx, sizeof rx));
    STATUS(BCAP_E_POINTER, bcap_client_init(&client, BCAP_LINK_STREAM, tx, SIZE_MAX, rx, sizeof rx));
    STATUS(BCAP_E_RANGE, bcap_client_init(&client, 3, tx, sizeof tx, rx, sizeof rx));

    /* not initialised, copied, after deinit */
    bcap_client *invalid[] = {&client, &copy, &client};
    for (int step = 0; step < 3; step++) {
        bcap_client *bad = invalid[step];
        if (step == 1) {
            OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx));
            memcpy(&copy, &client, sizeof copy);
        } else if (step == 2) {
            OK(bcap_client_deinit(&client));
        }
        STATUS(BCAP_E_HANDLE, bcap_client_deinit(bad));
        STATUS(BCAP_E_HANDLE, bcap_client_reset(bad));
        STATUS(BCAP_E_HANDLE, bcap_client_set_timing(bad, 1, 1, 1));
        STATUS(BCAP_E_HANDLE, bcap_client_set_serial(bad, 1));
        STATUS(BCAP_E_HANDLE, bcap_client_start(bad, 1, &value, 1, 0));
        STATUS(BCAP_E_HANDLE, bcap_client_transmit(bad, &bytes, &count));
        STATUS(BCAP_E_HANDLE, bcap_client_transmitted(bad, 0));
        STATUS(BCAP_E_HANDLE, bcap_client_receive_buffer(bad, &room, &count));
        STATUS(BCAP_E_HANDLE, bcap_client_received(bad, 0));
        STATUS(BCAP_E_HANDLE, bcap_client_poll(bad, 0, &event));
        STATUS(BCAP_E_HANDLE, bcap_client_deadline(bad, &at));
        STATUS(BCAP_E_HANDLE, bcap_client_value(bad, &value));
        STATUS(BCAP_E_HANDLE, bcap_client_abandon(bad));
    }

    /* null for each result, and counts that are too large */
    OK(bcap_client_init(&client, BCAP_LINK_STREAM, tx, sizeof tx, rx, sizeof rx));
    STATUS(BCAP_E_POINTER, bcap_client_start(&client, 1, NULL, 1, 0));
    STATUS(BCAP_E_POINTER, bcap_client_start(NULL, 1, &value, 1, 0));
    STATUS(BCAP_E_POINTER, bcap_client_transmit(&client, NULL, &count));
    STATUS(BCAP_E_POINTER, bcap_client_transmit(&client, &bytes, NULL));
    STATUS(BCAP_E_POINTER, bcap_client_receive_buffer(&client, &room, NULL));
    STATUS(BCAP_E_POINTER, bcap_client_poll(&client, 0, NULL));
    STATUS(BCAP_E_POINTER, bcap_client_deadline(&client, NULL));
    STATUS(BCAP_E_RANGE, bcap_client_transmitted(&client, 1));
    STATUS(BCAP_E_RANGE, bcap_client_received(&client, sizeof rx + 1));
    STATUS(BCAP_E_POINTER, bcap_value_integer(NULL, NULL));
    STATUS(BCAP_E_POINTER, bcap_value_integer(&value, NULL));
    STATUS(BCAP_E_POINTER, bcap_value_text(NULL, NULL, 0));
}

static void texts(void) {
    char text[256], cut[8];
    for (bcap_status status = 0; status < 32; status++) {
        size_t length = bcap_status_text(status, text, sizeof text);
        CHECK(length > 8 && length < sizeof text && strlen(text) == length && strncmp(text, "BCAP_", 5) == 0);
        memset(cut, 'x', sizeof cut);
        CHECK(bcap_status_text(status, cut, 4) == length && strlen(cut) == 3 && cut[4] == 'x');
        CHECK(bcap_status_text(status, NULL, 100) == length && bcap_status_text(status, cut, 0) == length);
    }
    bcap_status_text(12345, text, sizeof text);
    CHECK(strcmp(text, "0x00003039: a code that the library does not know") == 0);
}

int main(void) {
    calls();
    values();
    arguments();
    lines();
    misuse();
    texts();
    puts("sans_io: ok");
    return 0;
}
