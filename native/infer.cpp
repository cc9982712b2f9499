// Inference: hidden layer and readout step by step, nothing kept but the state, and out as soon as the rule says so.
#include "parallel.h"

#include "dispatch.hpp"
#include "layer.hpp"

namespace neurotact::NT_ISA {
namespace {

// The race of the classes; see networks/early_exit.py, Leader.
template <class Value>
struct Leader {
    Value* sums;
    int classes;
    int64_t index = 0, standing = 0, standing_since_spike = 0;
    bool heard = false;

    NT_INLINE int64_t leading() const {
        int64_t found = 0;
        for (int c = 1; c < classes; c++)
            if (sums[c] > sums[found]) found = c;
        return found;
    }
    NT_INLINE void after(bool moved) {
        const int64_t now = moved || standing == 0 ? leading() : index;
        const bool same = now == index;
        heard |= moved;
        index = now;
        standing = same ? standing + 1 : 1;
        standing_since_spike = same && heard ? standing_since_spike + 1 : heard;
    }
    NT_INLINE bool exits(const ExitRule& rule) const {
        return rule.patience >= 0 && (rule.from_first_spike ? standing_since_spike : standing) > rule.patience;
    }
};

// A readout that spikes and is counted.
template <class T>
class SpikingReadout {
public:
    using Value = int64_t;
    SpikingReadout(const Net<T>& net, const ForwardTables<T>& tables, Carver& carver)
        : neuron(net.neuron), layer(tables.readout), table(tables.readout_table), classes(net.sizes.classes),
          current(carver.take<T>(layer.pitch)), membrane(carver.take<T>(layer.pitch)),
          decided(carver.take<uint64_t>(words(classes))) {}
    static Value* counts_of(const Decisions& to) { return to.counts; }
    void start(Value* counts) {
        std::memset(current, 0, layer.pitch * sizeof(T));
        std::memset(membrane, 0, layer.pitch * sizeof(T));
        std::memset(decided, 0, words(classes) * sizeof(uint64_t));
        std::memset(counts, 0, classes * sizeof(Value));
    }
    // One step from the hidden neurons that spiked; whether a readout neuron is heard in it.
    NT_INLINE bool step(const uint32_t* rows, int n_rows, Value* counts) {
        bool any = false;
        if (!neuron.emits_at_once()) any = count(counts);
        advance_layer(neuron, layer, {table, rows, n_rows, 0}, {current, membrane, current, membrane, nullptr}, decided);
        if (neuron.emits_at_once()) any = count(counts);
        return any;
    }

private:
    const Neuron neuron;
    const LayerTables<T>& layer;
    const T* table;
    const int classes;
    T *current, *membrane;
    uint64_t* decided;

    NT_INLINE bool count(Value* counts) const {
        uint64_t any = 0;
        for (int64_t k = 0; k < words(classes); k++) {
            any |= decided[k];
            for (uint64_t m = decided[k]; m; m &= m - 1) counts[64 * k + lowest(m)]++;
        }
        return any != 0;
    }
};

// A readout that adds up a bias and the weights of every hidden spike, in float64 (networks/rsnn.py).
template <class T>
class IntegratingReadout {
public:
    using Value = double;
    IntegratingReadout(const Net<T>& net, const ForwardTables<T>&, Carver& carver)
        : weights(net.w_out), bias(net.bias), classes(net.sizes.classes), gained(carver.take<double>(classes)) {}
    static Value* counts_of(const Decisions& to) { return to.sums; }
    void start(Value* sums) { std::memcpy(sums, bias, classes * sizeof(double)); }
    NT_INLINE bool step(const uint32_t* rows, int n_rows, Value* sums) {
        if (n_rows == 0) return false;
        for (int c = 0; c < classes; c++) gained[c] = 0;
        for (int e = 0; e < n_rows; e++) {
            const T* row = weights + (int64_t)rows[e] * classes;
            for (int c = 0; c < classes; c++) gained[c] += row[c];
        }
        bool any = false;
        for (int c = 0; c < classes; c++) {
            any |= gained[c] != 0;
            sums[c] += gained[c];
        }
        return any;
    }

private:
    const T* weights;
    const double* bias;
    const int classes;
    double* gained;
};

template <class T, class Readout>
struct InferState {
    T *current, *membrane;
    uint64_t* inputs;
    SpikeHistory spikes;
    uint32_t* rows;
    Readout readout;

    InferState(const Net<T>& net, const ForwardTables<T>& tables, Carver& carver)
        : current(carver.take<T>(tables.hidden.pitch)), membrane(carver.take<T>(tables.hidden.pitch)),
          inputs(carver.take<uint64_t>(words(net.sizes.inputs))), spikes(net.sizes.hidden, carver),
          rows(carver.take<uint32_t>(net.sizes.inputs + net.sizes.hidden)), readout(net, tables, carver) {}
};

template <class T, class Readout>
bool infer_trial(const Net<T>& net, const ForwardTables<T>& tables, InferState<T, Readout>& s, int64_t trial,
                 const ExitRule& rule, const Decisions& to) {
    const Sizes& n = net.sizes;
    const int64_t in_words = words(n.inputs), hid_words = words(n.hidden);
    bool binary = true;
    std::memset(s.current, 0, tables.hidden.pitch * sizeof(T));
    std::memset(s.membrane, 0, tables.hidden.pitch * sizeof(T));
    s.spikes.clear(n.hidden);
    auto* counts = Readout::counts_of(to) + trial * n.classes;
    s.readout.start(counts);
    Leader<typename Readout::Value> leader{counts, n.classes};
    if (n.steps == 0) leader.index = leader.leading();
    int64_t steps = 0, input_spikes = 0, hidden_spikes = 0;
    while (steps < n.steps) {
        binary &= pack_step(net.spikes, trial, steps, n.inputs, s.inputs);
        int n_rows = list_rows(s.inputs, in_words, 0, s.rows, 0);
        input_spikes += n_rows;
        if (net.w_rec)
            n_rows = list_rows(s.spikes.recurrent(net.neuron.recurrent_delay), hid_words, n.inputs, s.rows, n_rows);
        advance_layer(net.neuron, tables.hidden, {tables.table, s.rows, n_rows, 0},
                      {s.current, s.membrane, s.current, s.membrane, nullptr}, s.spikes.next);
        const uint64_t* emitted = net.neuron.emits_at_once() ? s.spikes.next : s.spikes.now;
        n_rows = list_rows(emitted, hid_words, 0, s.rows, 0);
        hidden_spikes += n_rows;
        leader.after(s.readout.step(s.rows, n_rows, counts));
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

template <class T, class Readout>
bool infer_all(const Net<T>& net, const ExitRule& rule, const Decisions& to) {
    Carver measure, thread_measure;
    const ForwardTables<T> sizes(net, measure);
    InferState<T, Readout>(net, sizes, thread_measure);
    Block block(measure.bytes() + net.threads * thread_measure.bytes());
    Carver carver(block.data());
    const ForwardTables<T> tables(net, carver);
    char* thread_memory = block.data() + measure.bytes();
    int others = 0;
#pragma omp parallel num_threads(net.threads) reduction(+ : others)
    {
        Carver mine(thread_memory + omp_get_thread_num() * thread_measure.bytes());
        InferState<T, Readout> state(net, tables, mine);
#pragma omp for schedule(dynamic, 4)
        for (int64_t trial = 0; trial < net.sizes.trials; trial++)
            others += !infer_trial(net, tables, state, trial, rule, to);
    }
    return others == 0;
}

}  // namespace

template <class T>
bool infer(const Net<T>& net, const ExitRule& rule, const Decisions& to) {
    return net.bias ? infer_all<T, IntegratingReadout<T>>(net, rule, to)
                    : infer_all<T, SpikingReadout<T>>(net, rule, to);
}

template bool infer<NT_REAL>(const Net<NT_REAL>&, const ExitRule&, const Decisions&);

}  // namespace neurotact::NT_ISA
