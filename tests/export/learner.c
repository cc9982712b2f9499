/* Drives a chain that learns by records of numbers of 32 bits, here or in an emulator, and writes what it decides and its readout.
 * Records: E and the time and channel of an event, T and a time, L and a class and its number of touches, R a reset, F what was learned is
 * forgotten, W writes the readout, C counts of dropped windows and of decisions. The chain is compiled as "skin".
 */
#include "records.h"

static skin_chain chain;

static void advance(uint32_t time)
{
    static skin_decision decisions[SKIN_MOST_DECISIONS];
    for (int n = 1; n;) {
        n = skin_advance(&chain, time, decisions);
        for (int i = 0; i < n; i++) {
            const uint32_t row[3] = { 'D', decisions[i].label, decisions[i].hidden_spikes };
            harness_write((const uint8_t *)row, (int)sizeof row);
        }
        if (n) return;
    }
}

int main(void)
{
    skin_forget(&chain);
    skin_reset(&chain);
    for (;;) {
        uint32_t row[3];
        get(row, (int)sizeof row);
        if (row[0] == 'E') {
            while (!skin_event(&chain, row[1], row[2])) advance(row[1]);
        } else if (row[0] == 'T') {
            advance(row[1]);
        } else if (row[0] == 'L') {
            const uint32_t learned[3] = { 'L', (uint32_t)skin_learn(&chain, (uint8_t)row[1], row[2]), chain.readout.n_classes };
            harness_write((const uint8_t *)learned, (int)sizeof learned);
        } else if (row[0] == 'C') {
            const uint32_t counted[3] = { 'C', chain.tally.dropped, chain.tally.decisions };
            harness_write((const uint8_t *)counted, (int)sizeof counted);
        } else if (row[0] == 'R') {
            skin_reset(&chain);
        } else if (row[0] == 'F') {
            skin_forget(&chain);
        } else if (row[0] == 'W') {
            harness_write((const uint8_t *)chain.readout.w_out, (int)sizeof chain.readout.w_out);
            harness_write((const uint8_t *)chain.readout.bias, (int)sizeof chain.readout.bias);
        } else {
            break;
        }
    }
    harness_end(0);
    return 0;
}
