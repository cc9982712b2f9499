/* How a program of the tests reads its records. */
#include "harness.h"

static void get(void *to, int n)
{
    while (n > 0) {
        const int got = harness_read(to, n);
        if (got <= 0) harness_end(3);
        to = (uint8_t *)to + got;
        n -= got;
    }
}
