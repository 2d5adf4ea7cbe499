/* MPS2 AN385: the start, SysTick, two serial ports. */
#include "board.h"

#include <string.h>

#define CLOCK_HZ 25000000u
#define BAUD 115200u

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xe000e010)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xe000e014)

struct uart {
    volatile uint32_t data, state, control, interrupt, baud_divisor;
};

static struct uart *const uarts[] = {(struct uart *)0x40004000, (struct uart *)0x40005000};

enum { TX_FULL = 1, RX_FULL = 2 };

static volatile uint64_t milliseconds;

void tick(void) { milliseconds += 1; }

uint64_t now_us(void) {
    uint64_t now;
    /* the interrupt may change one half between the reads of both */
    do
        now = milliseconds;
    while (now != milliseconds);
    return now * 1000;
}

void uart_start(int port) {
    uarts[port]->baud_divisor = CLOCK_HZ / BAUD;
    uarts[port]->control = 3;
}

int uart_read(int port, uint8_t *byte) {
    if ((uarts[port]->state & RX_FULL) == 0)
        return 0;
    *byte = (uint8_t)uarts[port]->data;
    return 1;
}

int uart_write(int port, uint8_t byte) {
    if ((uarts[port]->state & TX_FULL) != 0)
        return 0;
    uarts[port]->data = byte;
    return 1;
}

void leave(int failed) {
    /* semihosting: SYS_EXIT with ADP_Stopped_ApplicationExit, or with a run-time error */
    register uint32_t operation __asm__("r0") = 0x18;
    register uint32_t reason __asm__("r1") = failed ? 0x20023 : 0x20026;
    __asm__ volatile("bkpt 0xab" : : "r"(operation), "r"(reason) : "memory");
    for (;;) {
    }
}

void fault(void) { leave(1); }

extern uint32_t data_start, data_end, data_load, bss_start, bss_end;

void board_start(void) {
    memcpy(&data_start, &data_load, (size_t)((char *)&data_end - (char *)&data_start));
    memset(&bss_start, 0, (size_t)((char *)&bss_end - (char *)&bss_start));
    SYSTICK_RELOAD = CLOCK_HZ / 1000 - 1;
    SYSTICK_CONTROL = 7;
}
