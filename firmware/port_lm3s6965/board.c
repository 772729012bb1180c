#include "board.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))

/* System control, chapter 5 of the data sheet. */
#define RCC REGISTER(0x400FE060u)
#define RIS REGISTER(0x400FE050u)
#define RCGC0 REGISTER(0x400FE100u)
#define RCGC1 REGISTER(0x400FE104u)
#define RCGC2 REGISTER(0x400FE108u)
#define RCC_BYPASS (1u << 11)
#define RCC_PWRDN (1u << 13)
#define RCC_USESYSDIV (1u << 22)
#define RCC_SYSDIV(divisor) (((divisor) - 1u) << 23)
#define RCC_XTAL_8MHZ (0xEu << 6)
#define RCC_MOSCDIS (1u << 0)
#define RCC_FIELDS (RCC_SYSDIV(16u) | RCC_PWRDN | (0xFu << 6) | (3u << 4) | RCC_MOSCDIS)
#define RIS_PLL_LOCKED (1u << 6)

/* GPIO ports A and F, chapter 8; the address of the data register carries the mask of the pins. */
#define GPIO_A 0x40004000u
#define GPIO_F 0x40025000u
#define GPIO_DATA(port, pins) REGISTER((port) + ((pins) << 2))
#define GPIO_AFSEL(port) REGISTER((port) + 0x420u)
#define GPIO_PUR(port) REGISTER((port) + 0x510u)
#define GPIO_DEN(port) REGISTER((port) + 0x51Cu)
#define ESTOP_PIN (1u << 1) /* PF1: the kit's push button, low while pressed */

/* General-purpose timer 0, chapter 9. */
#define TIMER0_CTL REGISTER(0x4003000Cu)
#define TIMER0_CFG REGISTER(0x40030000u)
#define TIMER0_TAMR REGISTER(0x40030004u)
#define TIMER0_IMR REGISTER(0x40030018u)
#define TIMER0_ICR REGISTER(0x40030024u)
#define TIMER0_TAILR REGISTER(0x40030028u)

/* Watchdog, chapter 10. */
#define WDT_LOAD REGISTER(0x40000000u)
#define WDT_CTL REGISTER(0x40000008u)
#define WDT_ICR REGISTER(0x4000000Cu)
#define WDT_LOCK REGISTER(0x40000C00u)
#define WDT_UNLOCK 0x1ACCE551u

/* UART 0, chapter 12: a PL011. */
#define UART_DR REGISTER(0x4000C000u)
#define UART_FR REGISTER(0x4000C018u)
#define UART_IBRD REGISTER(0x4000C024u)
#define UART_FBRD REGISTER(0x4000C028u)
#define UART_LCRH REGISTER(0x4000C02Cu)
#define UART_CTL REGISTER(0x4000C030u)
#define UART_IM REGISTER(0x4000C038u)
#define UART_ICR REGISTER(0x4000C044u)
#define FR_RXFE (1u << 4)
#define FR_TXFF (1u << 5)
#define INT_RX (1u << 4)
#define INT_TX (1u << 5)
#define INT_RX_TIMEOUT (1u << 6)

/* SysTick and NVIC, ARMv7-M B3.3 and B3.4. */
#define SYST_CSR REGISTER(0xE000E010u)
#define SYST_RVR REGISTER(0xE000E014u)
#define SYST_CVR REGISTER(0xE000E018u)
#define SYST_ALL 0x00FFFFFFu
#define NVIC_ISER0 REGISTER(0xE000E100u)
#define NVIC_ISPR0 REGISTER(0xE000E200u)
#define NVIC_PRIORITY(irq) (*(volatile uint8_t *)(0xE000E400u + (irq)))
#define IRQ_UART0 5u
#define IRQ_TIMER0A 19u

#define RING 1024u /* a power of two */

typedef struct {
    volatile uint8_t bytes[RING];
    volatile uint32_t in, out;
} ring;

static ring received, sending;
static volatile uint32_t received_us;
static uint32_t tick_us, tick_rest, tick_last;
static uint32_t last_boot_id __attribute__((section(".noinit")));

uint32_t board_hold(void)
{
    uint32_t before;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(before) : : "memory");
    return before;
}

void board_release(uint32_t before)
{
    __asm volatile("msr primask, %0" : : "r"(before) : "memory");
}

static void start_clock(void)
{
    /* 8 MHz crystal, PLL at 200 MHz over 8; bypassed until it has locked, section 5.3 */
    RCC |= RCC_BYPASS;
    RCC = (RCC & ~RCC_FIELDS) | RCC_XTAL_8MHZ | RCC_SYSDIV(8u) | RCC_USESYSDIV;
    while (!(RIS & RIS_PLL_LOCKED))
        continue;
    RCC &= ~RCC_BYPASS;
    SYST_RVR = SYST_ALL;
    SYST_CVR = 0;
    SYST_CSR = 5; /* the processor's clock, no interrupt: it is read, not counted */
    tick_last = 0;
}

static void start_uart(void)
{
    uint32_t sixtyfourths = (4u * BOARD_HZ + BAUD / 2u) / BAUD; /* of the divisor BOARD_HZ / (16 BAUD) */
    GPIO_AFSEL(GPIO_A) |= 3u;
    GPIO_DEN(GPIO_A) |= 3u;
    UART_CTL = 0;
    UART_IBRD = sixtyfourths >> 6;
    UART_FBRD = sixtyfourths & 63u;
    UART_LCRH = 3u << 5 | 1u << 4; /* 8 bits, no parity, 1 stop bit, FIFOs */
    UART_CTL = 1u << 9 | 1u << 8 | 1u;
    UART_IM = INT_RX | INT_TX | INT_RX_TIMEOUT;
}

static void start_current_loop(void)
{
    TIMER0_CTL = 0;
    TIMER0_CFG = 0;  /* one timer of 32 bits */
    TIMER0_TAMR = 2; /* periodic */
    TIMER0_TAILR = BOARD_HZ / LOOP_HZ - 1u;
    TIMER0_IMR = 1;
    TIMER0_CTL = 1;
}

void board_init(void)
{
    (void)board_hold();
    RCGC0 |= 1u << 3;             /* watchdog */
    RCGC1 |= 1u << 16 | 1u;       /* timer 0, UART 0 */
    RCGC2 |= 1u << 5 | 1u;        /* GPIO F, GPIO A */
    (void)RCGC2;                  /* the clocks take a few cycles */
    start_clock();
    GPIO_PUR(GPIO_F) |= ESTOP_PIN;
    GPIO_DEN(GPIO_F) |= ESTOP_PIN;
    start_uart();
    start_current_loop();
    NVIC_PRIORITY(IRQ_TIMER0A) = 0;
    NVIC_PRIORITY(IRQ_UART0) = 1u << 5;
    NVIC_ISER0 = 1u << IRQ_TIMER0A | 1u << IRQ_UART0;
}

uint32_t board_boot_id(void)
{
    extern uint32_t bss_end[];
    const uint32_t *end = (const uint32_t *)0x20010000u;
    uint32_t hash = 2166136261u; /* FNV-1a over words */
    for (const uint32_t *word = bss_end; word < end; word++)
        hash = (hash ^ *word) * 16777619u;
    hash = (hash ^ last_boot_id) * 16777619u;
    last_boot_id = hash ? hash : 1u;
    return last_boot_id;
}

uint32_t board_tick_us(void)
{
    uint32_t before = board_hold();
    uint32_t now = SYST_CVR; /* counts down, modulo 2^24: 0.67 s */
    tick_rest += (tick_last - now) & SYST_ALL;
    tick_last = now;
    tick_us += tick_rest / (BOARD_HZ / 1000000u);
    tick_rest %= BOARD_HZ / 1000000u;
    now = tick_us;
    board_release(before);
    return now;
}

void board_watchdog_start(void)
{
    WDT_LOCK = WDT_UNLOCK;
    WDT_LOAD = BOARD_HZ / 1000u * WATCHDOG_HALF_MS;
    WDT_CTL = 3; /* interrupt, which starts it for good, and reset */
    WDT_LOCK = 0;
}

void board_watchdog_kick(void)
{
    WDT_LOCK = WDT_UNLOCK;
    WDT_ICR = 1; /* takes back a warning, and loads */
    WDT_LOAD = BOARD_HZ / 1000u * WATCHDOG_HALF_MS;
    WDT_LOCK = 0;
}

bool board_estop_open(void)
{
    return GPIO_DATA(GPIO_F, ESTOP_PIN) == 0;
}

void uart0_interrupt(void)
{
    UART_ICR = INT_RX | INT_TX | INT_RX_TIMEOUT;
    while (!(UART_FR & FR_RXFE)) {
        uint8_t byte = (uint8_t)UART_DR;
        if (received.in - received.out < RING)
            received.bytes[received.in++ % RING] = byte;
        received_us = board_tick_us();
    }
    while (sending.out != sending.in && !(UART_FR & FR_TXFF))
        UART_DR = sending.bytes[sending.out++ % RING];
}

void timer0a_interrupt(void)
{
    TIMER0_ICR = 1;
    current_loop();
}

size_t board_receive(uint8_t *bytes, size_t room, uint32_t *last_us)
{
    size_t n = 0;
    uint32_t before = board_hold();
    while (n < room && received.out != received.in)
        bytes[n++] = received.bytes[received.out++ % RING];
    *last_us = received_us;
    board_release(before);
    return n;
}

void board_send(const uint8_t *bytes, size_t size)
{
    if (RING - (sending.in - sending.out) < size)
        return; /* a frame goes whole or not at all */
    for (size_t i = 0; i < size; i++)
        sending.bytes[(sending.in + i) % RING] = bytes[i];
    sending.in += size;
    NVIC_ISPR0 = 1u << IRQ_UART0;
}

void board_wait(void)
{
    __asm volatile("wfi");
}
