/* The board: a Stellaris LM3S6965 (Cortex-M3) evaluation kit, as far as a leg controller needs it.
 *
 * Registers are written down here from the LM3S6965 data sheet (Texas Instruments) and, for SysTick and NVIC, from the
 * ARMv7-M Architecture Reference Manual (ARM DDI 0403), chapter B3; no vendor code. MIT. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define BOARD_HZ 25000000u
#define BAUD 1000000u
#define LOOP_HZ 2000u       /* current loop */
#define WATCHDOG_HALF_MS 25u /* the first time out only warns, the second resets: 50 ms in all */

/* Everything off, clock, port, timers; interrupts still disabled. */
void board_init(void);

/* A number that the boot before did not have: from SRAM as it comes up, and from what the last boot left in it. */
uint32_t board_boot_id(void);

/* Microseconds since boot, modulo 2^32; exact as long as somebody asks twice a second. */
uint32_t board_tick_us(void);

/* The hardware watchdog, which nothing stops once it runs. */
void board_watchdog_start(void);
void board_watchdog_kick(void);

/* The E-stop is pressed. */
bool board_estop_open(void);

/* What came in since the last call, up to room bytes, and when its last byte did. */
size_t board_receive(uint8_t *bytes, size_t room, uint32_t *last_us);

/* Queue for the host; what does not fit is lost, as on any line that nobody reads fast enough. */
void board_send(const uint8_t *bytes, size_t size);

/* No interrupt until board_release with what board_hold returned. */
uint32_t board_hold(void);
void board_release(uint32_t before);

/* Sleep until an interrupt. */
void board_wait(void);

/* The program's, called LOOP_HZ times a second, ahead of everything else. */
void current_loop(void);

#endif
