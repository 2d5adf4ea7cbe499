/* Random sequences of calls with a fixed seed: random ADDRESS [SEQUENCES]. Any status is accepted, and no memory error is. */
#include "check.h"

static uint64_t state = 0x2545f4914f6cdd1dULL;

static uint32_t below(uint32_t limit) {
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)((state >> 16) % limit);
}

static unsigned long statuses[64], refusals;

static void count_status(bcap_status status) {
    if (status < 0)
        refusals++;
    else
        statuses[status < 63 ? status : 63]++;
    CHECK(status != BCAP_E_PANIC);
}

/* A value with content of the caller: often valid, sometimes not. */
static bcap_value value_of(int depth) {
    static const double numbers[16];
    static bcap_value elements[8][4];
    static const char *const texts[] = {"", "I1", "CaoProv.DENSO.VRC", "\xc3\xa9", "\xff", NULL};
    bcap_value garbage;
    switch (below(8)) {
    case 0:
        return bcap_i4((int32_t)below(1000) - 500);
    case 1:
        return bcap_text(texts[below(6)]);
    case 2:
        return bcap_array((uint16_t)below(24), below(9) == 0 ? NULL : numbers, below(17));
    case 3:
        if (depth >= 8)
            return bcap_empty();
        for (int index = 0; index < 4; index++)
            elements[depth][index] = value_of(depth + 1);
        return bcap_list(elements[depth], below(5));
    case 4:
        return bcap_integer((uint16_t)below(24), (int64_t)below(70000) - 35000);
    case 5:
        return bcap_r8((double)below(100) / 7);
    case 6:
        /* no pointer: only what C can copy from one value to another */
        memset(&garbage, 0, sizeof garbage);
        garbage.type = (uint16_t)below(65536);
        garbage.form = (uint16_t)below(8);
        garbage.count = below(3);
        return garbage;
    default:
        return bcap_bool(below(2) == 1);
    }
}

/* Reads a value in all ways. */
static void use(const bcap_value *value) {
    int64_t integer;
    double numbers[4];
    char text[8];
    size_t count;
    bcap_value element;
    count_status(bcap_value_integer(value, &integer));
    count_status(bcap_value_number(value, numbers));
    count_status(bcap_value_text(value, text, below(9)));
    count_status(bcap_value_numbers(value, numbers, below(5), &count));
    if (bcap_value_element(value, below(4), &element) == BCAP_OK)
        count_status(bcap_value_integer(&element, &integer));
}

/* Puts bytes into the receive buffer: noise, a beginning of the request, or a reply to it. */
static void receive(bcap_client *client, const uint8_t *request, size_t length) {
    uint8_t *room;
    size_t size;
    bcap_status status = bcap_client_receive_buffer(client, &room, &size);
    count_status(status);
    if (status != BCAP_OK)
        return;
    size_t count = below(64);
    if (below(3) > 0 && length > 16) {
        count = length < size ? length : size;
        memcpy(room, request, count);
        /* the result in place of the function */
        if (count > 13)
            memset(room + 9, 0, 4);
        if (below(4) == 0 && count > 0)
            room[below((uint32_t)count)] ^= (uint8_t)(1 << below(8));
    } else {
        for (size_t index = 0; index < count && index < size; index++)
            room[index] = (uint8_t)below(256);
    }
    count_status(bcap_client_received(client, count));
}

static void sans_io(void) {
    static bcap_client clients[2];
    static uint8_t memory[2][2][256];
    static uint64_t now;
    uint8_t request[256];
    size_t length = 0;
    for (uint32_t steps = 1 + below(24); steps > 0; steps--) {
        const uint32_t chosen = below(2);
        bcap_client *client = below(40) == 0 ? NULL : &clients[chosen];
        const uint8_t *bytes;
        size_t count;
        bcap_event event;
        bcap_value arguments[3] = {value_of(0), value_of(0), value_of(0)}, value;
        uint64_t at;
        switch (below(12)) {
        case 0:
            count_status(bcap_client_init(client, (int32_t)below(4), memory[chosen][0], below(257),
                                          below(20) == 0 ? NULL : memory[chosen][1], below(257)));
            break;
        case 1:
        case 2:
        case 3:
            count_status(bcap_client_start(client, (int32_t)below(140), arguments, below(4), now));
            break;
        case 4:
        case 5:
            if (bcap_client_transmit(client, &bytes, &count) == BCAP_OK && count > 0) {
                length = count;
                memcpy(request, bytes, count);
                count_status(bcap_client_transmitted(client, below(3) == 0 ? below(300) : count));
            }
            break;
        case 6:
        case 7:
            receive(client, request, length);
            break;
        case 8:
            now += below(4) == 0 ? below(1000000) : below(100);
            count_status(bcap_client_poll(client, now, &event));
            if (bcap_client_value(client, &value) == BCAP_OK)
                use(&value);
            break;
        case 9:
            count_status(bcap_client_deadline(client, &at));
            count_status(below(2) ? bcap_client_abandon(client) : bcap_client_reset(client));
            break;
        case 10:
            count_status(below(20) == 0 ? bcap_client_deinit(client) : bcap_client_set_serial(client, (uint16_t)below(65536)));
            break;
        default:
            use(&arguments[0]);
        }
    }
}

static void rac(void) {
    static const char *const replies[] = {"0", "0,3,5", "-2147024809", "0,8196,1,2", "0,8204,(3,1),(8,x)", "x", "0,99,1"};
    static const char *const names[] = {"I1", "P[3]", "S2", "", "I", "I99999999999", NULL};
    char line[256], text[32];
    uint8_t memory[64];
    size_t length;
    bcap_value value = value_of(0);
    count_status(bcap_rac_get(names[below(7)], line, below(257), &length));
    count_status(bcap_rac_put(names[below(7)], &value, line, below(257), &length));
    strcpy(text, replies[below(7)]);
    length = strlen(text);
    if (below(2) == 0)
        text[below((uint32_t)length)] ^= (char)(1 << below(7));
    count_status(bcap_rac_reply(text, length, memory, below(65), &value));
    use(&value);
}

static void hosted(const char *address) {
    static bcap_controller cells[4];
    const bcap_controller cell = cells[below(4)];
    const bcap_value argument = value_of(0);
    uint8_t memory[128];
    bcap_value value;
    int64_t integer;
    double numbers[8];
    size_t count;
    char text[64];
    switch (below(12)) {
    case 0:
        count_status(bcap_connect(address, BCAP_RC8, &cells[below(4)]));
        break;
    case 1:
        count_status(bcap_close(cell));
        break;
    case 2:
        count_status(bcap_read_integer(cell, "I1", &integer));
        break;
    case 3:
        count_status(bcap_read_text(cell, "@VERSION", text, below(65)));
        break;
    case 4:
        count_status(bcap_write(cell, "I1", argument));
        break;
    case 5:
        if (bcap_read(cell, "P1", memory, below(129), &value) == BCAP_OK)
            use(&value);
        break;
    case 6:
        count_status(bcap_execute(cell, "ClearError", argument, memory, sizeof memory, &value));
        break;
    case 7:
        count_status(below(2) ? bcap_take_arm(cell) : bcap_give_arm(cell));
        break;
    case 8:
        count_status(bcap_call(cell, (int32_t)below(3) == 0 ? 101 : 92, &argument, 1, memory, sizeof memory, &value));
        break;
    case 9:
        count_status(bcap_stream_step(cell, numbers, NULL));
        break;
    case 10:
        count_status(bcap_read_numbers(cell, "P1", numbers, below(9), &count));
        break;
    default:
        count_status(bcap_wait(cell));
        CHECK(bcap_message(text, sizeof text) > 0);
    }
}

int main(int argc, char **argv) {
    CHECK(argc > 1);
    const long sequences = argc > 2 ? atol(argv[2]) : 10000;
    for (long sequence = 0; sequence < sequences; sequence++) {
        sans_io();
        rac();
        hosted(argv[1]);
    }
    /* the sequences reach what they are for */
    CHECK(statuses[BCAP_OK] > 1000 && statuses[BCAP_E_HANDLE] > 100 && statuses[BCAP_E_POINTER] > 100);
    CHECK(statuses[BCAP_E_BUSY] > 10 && statuses[BCAP_E_VALUE] > 100 && statuses[BCAP_E_NO_STREAM] > 10);
    printf("random: %ld sequences, %lu successes, %lu refusals\n", sequences, statuses[BCAP_OK], refusals);
    return 0;
}
