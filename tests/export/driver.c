/* Drives a chain by records of a letter each, here or in an emulator, and writes its spikes, decisions and counts.
 * Records: P a sample, M a missing one, G a gap, R a reset, F the end of a trial, A the state of a chain that has run for long, C the counts
 * of one, B its number of missing samples in a row, T writes the counts. The chain is compiled as "skin".
 */
#include "records.h"

static skin_chain chain;

static void put(char letter, const void *from, int n)
{
    const uint8_t tag = (uint8_t)letter;
    harness_write(&tag, 1);
    harness_write(from, n);
}

void skin_on_spikes(const AFFERENT *afferents, int n_afferents);
void skin_on_hidden(uint32_t window, const NEURON *neurons, int n_neurons);

void skin_on_spikes(const AFFERENT *afferents, int n_afferents)
{
    uint32_t sum[2] = { (uint32_t)n_afferents, 0 };
    for (int i = 0; i < n_afferents; i++) sum[1] = 31 * sum[1] + afferents[i] + 1u;
    put('S', sum, (int)sizeof sum);
}

void skin_on_hidden(uint32_t window, const NEURON *neurons, int n_neurons)
{
    (void)window;
    (void)neurons;
    (void)n_neurons;
}

static void age(void)
{
    get(&chain.step, 4);
    get(&chain.n_windows, 4);
#ifdef HEARD
    get(&chain.n_heard, (int)sizeof chain.n_heard);
    for (int i = 0; i < SKIN_TAXELS; i++) get(&chain.taxels[i].total, 8);
#endif
#ifdef POSITION
    get(&chain.n_samples, 8);
    get(&chain.n_steps, 8);
#endif
#ifdef FELT
    get(&chain.n_felt, 8);
#endif
}

int main(void)
{
    static skin_decision decisions[SKIN_MOST_DECISIONS];
    skin_sample sample[SKIN_TAXELS];
    skin_reset(&chain);
    for (;;) {
        char letter;
        int n = 0;
        get(&letter, 1);
        if (letter == 'P') {
            get(sample, (int)sizeof sample);
            n = skin_push(&chain, sample, decisions);
        } else if (letter == 'M') {
            n = skin_missing(&chain, decisions);
#ifdef FINISHES
        } else if (letter == 'F') {
            n = skin_finish(&chain, decisions);
#endif
        } else if (letter == 'G') {
            skin_gap(&chain);
        } else if (letter == 'R') {
            skin_reset(&chain);
        } else if (letter == 'A') {
            age();
        } else if (letter == 'C') {
            get(&chain.tally, (int)sizeof chain.tally);
        } else if (letter == 'B') {
            get(&chain.n_bad, 4);
        } else if (letter == 'T') {
            put('T', &chain.tally, (int)sizeof chain.tally);
        } else {
            break;
        }
        for (int i = 0; i < n; i++) {
            const uint32_t row[8] = { decisions[i].window, decisions[i].start_step, decisions[i].steps,
                decisions[i].input_spikes, decisions[i].hidden_spikes, decisions[i].held, decisions[i].heard,
                decisions[i].label };
            put('D', row, (int)sizeof row);
        }
    }
    harness_end(0);
    return 0;
}
