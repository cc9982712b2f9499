/* The harness on the machine that compiles it: files are its arguments' places, standard input and output. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

int harness_read(uint8_t *to, int most);
void harness_write(const uint8_t *from, int n);
void harness_end(int code);
uint32_t harness_ticks(void);
uint32_t harness_elapsed(uint32_t began);

int harness_read(uint8_t *to, int most)
{
    return (int)fread(to, 1, (size_t)most, stdin);
}

void harness_write(const uint8_t *from, int n)
{
    if (fwrite(from, 1, (size_t)n, stdout) != (size_t)n) exit(4);
}

void harness_end(int code)
{
    fflush(stdout);
    exit(code);
}

uint32_t harness_ticks(void)
{
    return 0;
}

uint32_t harness_elapsed(uint32_t began)
{
    return began;
}
