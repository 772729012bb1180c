/* Vectors, memory, and what a freestanding compiler may call by itself. MIT. */
#include <stddef.h>
#include <stdint.h>

extern uint32_t stack_top[], data_start[], data_end[], data_load[], bss_start[], bss_end[];
int main(void);
void uart0_interrupt(void);
void timer0a_interrupt(void);

void *memcpy(void *restrict to, const void *restrict from, size_t size)
{
    for (size_t i = 0; i < size; i++)
        ((volatile uint8_t *)to)[i] = ((const uint8_t *)from)[i]; /* volatile: else this becomes a call of itself */
    return to;
}

void *memset(void *to, int value, size_t size)
{
    for (size_t i = 0; i < size; i++)
        ((volatile uint8_t *)to)[i] = (uint8_t)value;
    return to;
}

void reset(void)
{
    memcpy(data_start, data_load, (size_t)((uint8_t *)data_end - (uint8_t *)data_start));
    memset(bss_start, 0, (size_t)((uint8_t *)bss_end - (uint8_t *)bss_start));
    main();
}

/* A fault, or an interrupt that nobody asked for: stand still, and the watchdog resets the board. */
static void halt(void)
{
    for (;;)
        continue;
}

#define SYSTEM 16 /* exceptions before the first interrupt */

__attribute__((section(".vectors"), used)) static void (*const vectors[SYSTEM + 44])(void) = {
    (void (*)(void))stack_top, reset, halt, halt, halt, halt, halt, [11] = halt, [12] = halt, [14] = halt, [15] = halt,
    [SYSTEM + 5] = uart0_interrupt, [SYSTEM + 18] = halt, [SYSTEM + 19] = timer0a_interrupt,
};
