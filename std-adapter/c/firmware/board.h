/* The parts of the board that the program needs. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

/* The time since the start, in microseconds. */
uint64_t now_us(void);
/* Starts a serial port: 0 is the line to the robot, 1 the console. */
void uart_start(int port);
/* Takes a byte; returns 0 when there is none. */
int uart_read(int port, uint8_t *byte);
/* Gives a byte; returns 0 when there is no room. */
int uart_write(int port, uint8_t byte);
/* Ends the program in the emulator. */
void leave(int failed);
/* Sets up memory and SysTick; the first call after a reset. */
void board_start(void);
/* The handler of SysTick, each millisecond. */
void tick(void);
/* The handler of all faults, which ends the program. */
void fault(void);

#endif
