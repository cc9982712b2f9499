/* A Cortex-M without an operating system, emulated by QEMU: the start, files by semihosting, time by SysTick or another timer.
 * Semihosting: Arm IHI 0100; SysTick: Armv6-M Architecture Reference Manual, B3.3.
 */
#include <stdint.h>

int main(void);
int harness_read(uint8_t *to, int most);
void harness_write(const uint8_t *from, int n);
void harness_end(int code);
uint32_t harness_ticks(void);
uint32_t harness_elapsed(uint32_t began);
void reset(void);
void *memset(void *to, int value, unsigned int n);
void *memcpy(void *to, const void *from, unsigned int n);

extern uint32_t stack_top, data_from, data_start, data_end, bss_start, bss_end;

#define SYST_CSR (*(volatile uint32_t *)0xE000E010)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018)
#ifdef TIMER /* a timer of 32 bits, which counts down: of Arm's CMSDK (DDI 0479, 4.2) */
#define TIMER_CTRL (*(volatile uint32_t *)(TIMER + 0x0u))
#define TIMER_VALUE (*(volatile uint32_t *)(TIMER + 0x4u))
#define TIMER_RELOAD (*(volatile uint32_t *)(TIMER + 0x8u))
#endif
#define CPACR (*(volatile uint32_t *)0xE000ED88)

enum { SYS_OPEN = 1, SYS_WRITE = 5, SYS_READ = 6, SYS_EXIT_EXTENDED = 0x20 };

static int semihosting(int operation, const uint32_t *block)
{
    register int r0 __asm__("r0") = operation;
    register const uint32_t *r1 __asm__("r1") = block;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static uint32_t file(const char *name, uint32_t length, uint32_t mode)
{
    const uint32_t block[3] = { (uint32_t)name, mode, length };
    return (uint32_t)semihosting(SYS_OPEN, block);
}

static uint32_t in_file, out_file;

int harness_read(uint8_t *to, int most)
{
    const uint32_t block[3] = { in_file, (uint32_t)to, (uint32_t)most };
    return most - semihosting(SYS_READ, block); /* it returns what is missing */
}

void harness_write(const uint8_t *from, int n)
{
    const uint32_t block[3] = { out_file, (uint32_t)from, (uint32_t)n };
    if (semihosting(SYS_WRITE, block) != 0) harness_end(4);
}

void harness_end(int code)
{
    const uint32_t block[2] = { 0x20026, (uint32_t)code }; /* ADP_Stopped_ApplicationExit */
    semihosting(SYS_EXIT_EXTENDED, block);
    for (;;) { }
}

uint32_t harness_ticks(void)
{
#ifdef TIMER
    return TIMER_VALUE;
#else
    return SYST_CVR;
#endif
}

uint32_t harness_elapsed(uint32_t began)
{
#ifdef TIMER
    return began - TIMER_VALUE;
#else
    return (began - SYST_CVR) & 0xFFFFFF; /* it counts down, 24 bits */
#endif
}

void *memset(void *to, int value, unsigned int n)
{
    volatile uint8_t *byte = to;
    while (n--) *byte++ = (uint8_t)value;
    return to;
}

void *memcpy(void *to, const void *from, unsigned int n)
{
    volatile uint8_t *byte = to;
    const uint8_t *other = from;
    while (n--) *byte++ = *other++;
    return to;
}

void reset(void)
{
#ifdef __ARM_FP
    CPACR |= 0xFu << 20;
    __asm__ volatile("dsb\n\tisb");
#endif
    const uint32_t *from = &data_from;
    for (uint32_t *to = &data_start; to < &data_end; to++) *to = *from++;
    for (uint32_t *to = &bss_start; to < &bss_end; to++) *to = 0;
    SYST_RVR = 0xFFFFFF;
    SYST_CVR = 0;
    SYST_CSR = 5;
#ifdef TIMER
    TIMER_RELOAD = TIMER_VALUE = 0xFFFFFFFF;
    TIMER_CTRL = 1;
#endif
    in_file = file("input.bin", 9, 1);   /* rb */
    out_file = file("output.bin", 10, 5); /* wb */
    harness_end(main());
}

static void stopped(void)
{
    harness_end(5);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (void *)reset, (void *)stopped, (void *)stopped, (void *)stopped, (void *)stopped, (void *)stopped,
};
