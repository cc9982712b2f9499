// Inference: hidden layer and readout step by step, nothing kept but the state, and out as soon as the rule says so.
#include "parallel.h"

#include "dispatch.hpp"
#include "layer.hpp"

namespace neurotact::NT_ISA {
namespace {

NT_INLINE int64_t population(const uint64_t* bits, int64_t n_words) {
    int64_t sum = 0;
    for (int64_t k = 0; k < n_words; k++) sum += __builtin_popcountll(bits[k]);
    return sum;
}

template <class T>
struct InferState {
    T *current, *membrane, *readout_current, *readout_membrane;
    uint64_t *inputs, *decided;
    SpikeHistory spikes;
    uint32_t* rows;
    size_t cleared;  // bytes from `current` on

    InferState(const Sizes& n, const Layout& layout, Carver& carver) : spikes(n.hidden, carver) {
        const size_t start = carver.bytes();
        current = carver.take<T>(layout.hidden_pitch);
        membrane = carver.take<T>(layout.hidden_pitch);
        readout_current = carver.take<T>(layout.readout_pitch);
        readout_membrane = carver.take<T>(layout.readout_pitch);
        decided = carver.take<uint64_t>(words(n.classes));
        cleared = carver.bytes() - start;
        inputs = carver.take<uint64_t>(words(n.inputs));
        rows = carver.take<uint32_t>(n.inputs + n.hidden);
    }
};

// The race of the readout neurons; see networks/early_exit.py, Leader.
struct Leader {
    int64_t index = 0, standing = 0, standing_since_spike = 0;
    bool heard = false;

    NT_INLINE void after(const uint64_t* decided, int classes, int64_t* counts) {
        int64_t leading = index;
        uint64_t any = 0;
        for (int64_t k = 0; k < words(classes); k++) {
            any |= decided[k];
            for (uint64_t m = decided[k]; m; m &= m - 1) counts[64 * k + lowest(m)]++;
        }
        if (any) {
            heard = true;
            leading = 0;
            for (int c = 1; c < classes; c++)
                if (counts[c] > counts[leading]) leading = c;
        }
        const bool same = leading == index;
        index = leading;
        standing = same ? standing + 1 : 1;
        standing_since_spike = same && heard ? standing_since_spike + 1 : heard;
    }
    NT_INLINE bool exits(const ExitRule& rule) const {
        return rule.patience >= 0 && (rule.from_first_spike ? standing_since_spike : standing) > rule.patience;
    }
};

template <class T, Membrane M, Reset R>
bool infer_trial(const Net<T>& net, const ForwardTables<T>& tables, InferState<T>& s, int64_t trial,
                 const ExitRule& rule, const Decisions& to) {
    const Sizes& n = net.sizes;
    const int64_t in_words = words(n.inputs), hid_words = words(n.hidden);
    bool binary = true;
    std::memset(s.current, 0, s.cleared);
    s.spikes.clear(n.hidden);
    int64_t* counts = to.readout + trial * n.classes;
    std::memset(counts, 0, n.classes * sizeof(int64_t));
    Leader leader;
    int64_t steps = 0, input_spikes = 0, hidden_spikes = 0;
    while (steps < n.steps) {
        binary &= pack_step(net.spikes, trial, steps, n.inputs, s.inputs);
        int n_rows = list_rows(s.inputs, in_words, 0, s.rows, 0);
        input_spikes += n_rows;
        n_rows = list_rows(s.spikes.recurrent(net.recurrent_delay), hid_words, n.inputs, s.rows, n_rows);
        advance_layer<T, M, R>(tables.hidden, tables.table, s.rows, n_rows, s.current, s.membrane, s.spikes.next);
        const uint64_t* emitted = M == Membrane::immediate ? s.spikes.next : s.spikes.now;
        hidden_spikes += population(emitted, hid_words);
        if (M != Membrane::immediate) leader.after(s.decided, n.classes, counts);
        n_rows = list_rows(emitted, hid_words, 0, s.rows, 0);
        advance_layer<T, M, R>(tables.readout, tables.readout_table, s.rows, n_rows, s.readout_current,
                               s.readout_membrane, s.decided);
        if (M == Membrane::immediate) leader.after(s.decided, n.classes, counts);
        s.spikes.step();
        steps++;
        if (leader.exits(rule)) break;
    }
    to.labels[trial] = leader.index;
    to.steps[trial] = steps;
    to.input_spikes[trial] = input_spikes;
    to.hidden_spikes[trial] = hidden_spikes;
    return binary;
}

}  // namespace

template <class T>
bool infer(const Net<T>& net, const Layout& layout, const ExitRule& rule, const Decisions& to) {
    Carver measure, thread_measure;
    ForwardTables<T>(net, layout, measure);
    InferState<T>(net.sizes, layout, thread_measure);
    Block block(measure.bytes() + net.threads * thread_measure.bytes());
    Carver carver(block.data());
    const ForwardTables<T> tables(net, layout, carver);
    char* thread_memory = block.data() + measure.bytes();
    int others = 0;
#pragma omp parallel num_threads(net.threads) reduction(+ : others)
    {
        Carver mine(thread_memory + omp_get_thread_num() * thread_measure.bytes());
        with_variant(net.membrane, net.reset, [&](auto M, auto R) {
#pragma omp for schedule(dynamic, 4)
            for (int64_t trial = 0; trial < net.sizes.trials; trial++) {
                Carver again = mine;
                InferState<T> state(net.sizes, layout, again);
                others += !infer_trial<T, M.value, R.value>(net, tables, state, trial, rule, to);
            }
        });
    }
    return others == 0;
}

template bool infer<NT_REAL>(const Net<NT_REAL>&, const Layout&, const ExitRule&, const Decisions&);

}  // namespace neurotact::NT_ISA
