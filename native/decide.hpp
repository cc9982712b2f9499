// A window of a network, step by step: hidden layer, readout and the race of the classes. Used by infer.cpp and stream.cpp.
#pragma once

#include <limits>

#include "layer.hpp"

namespace neurotact::NT_ISA {

// The race of the classes; see neurotact/networks/exit/rule.py, Leader.
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
    // By how much the leader exceeds every other class.
    NT_INLINE double lead() const {
        double least = std::numeric_limits<double>::infinity();
        for (int c = 0; c < classes; c++) {
            const double ahead = (double)(sums[index] - sums[c]);
            if (c != index && ahead < least) least = ahead;
        }
        return least;
    }
    // `changed`: whether the sums may be others than a step before.
    NT_INLINE void after(bool moved, bool changed) {
        const int64_t now = changed || standing == 0 ? leading() : index;
        const bool same = now == index;
        heard |= moved;
        index = now;
        standing = same ? standing + 1 : 1;
        standing_since_spike = same && heard ? standing_since_spike + 1 : heard;
    }
    // The decision: the leading class, or the number of classes for none of them.
    NT_INLINE int64_t told(const ExitRule& rule) const {
        return rule.least_lead > 0 && lead() < rule.least_lead ? classes : index;
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
    static constexpr bool leaks() { return false; }
    void start(Value* counts) {
        std::memset(current, 0, layer.pitch * sizeof(T));
        std::memset(membrane, 0, layer.pitch * sizeof(T));
        std::memset(decided, 0, words(classes) * sizeof(uint64_t));
        std::memset(counts, 0, classes * sizeof(Value));
    }
    template <class Visit>
    void each_part(const Visit& visit) {
        visit(current, classes * sizeof(T));
        visit(membrane, classes * sizeof(T));
        visit(decided, words(classes) * sizeof(uint64_t));
    }
    // One step from the hidden neurons that spiked; whether a readout neuron is heard in it.
    NT_INLINE bool step(const uint32_t* rows, int n_rows, int64_t, Value* counts) {
        bool any = false;
        if (!neuron.emits_at_once()) any = count(counts);
        advance_layer(neuron, layer, {table, rows, n_rows, 0},
                      LayerState<T>{current, membrane, current, membrane, nullptr}, decided);
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

// A readout that adds up a bias and the weights of every spike that it hears, in float64
// (neurotact/networks/definition/readouts.py). `sums` are its values; one that leaks has y beside them.
template <class T>
class IntegratingReadout {
public:
    using Value = double;
    IntegratingReadout(const Net<T>& net, const ForwardTables<T>&, Carver& carver)
        : weights(net.w_out), bias(net.bias), heard(net.sizes.hidden + net.integration.direct * net.sizes.inputs),
          classes(net.sizes.classes), how(net.integration),
          gained(carver.take<double>(classes)), y(carver.take<double>(classes)) {}
    static Value* counts_of(const Decisions& to) { return to.sums; }
    bool leaks() const { return how.leaks; }
    template <class Visit>
    void each_part(const Visit& visit) {
        if (how.leaks) visit(y, classes * sizeof(double));
    }
    void start(Value* sums) {
        std::memcpy(sums, bias, classes * sizeof(double));
        std::memset(y, 0, classes * sizeof(double));
    }
    // now: the step of the window, from 0.
    NT_INLINE bool step(const uint32_t* rows, int n_rows, int64_t now, Value* sums) {
        if (n_rows == 0 && !how.leaks) return false;
        const T* table = weights;
        if (how.stretches > 1) table += how.stretch_of(now) * heard * classes;
        for (int c = 0; c < classes; c++) gained[c] = 0;
        for (int e = 0; e < n_rows; e++) {
            const T* row = table + (int64_t)rows[e] * classes;
            for (int c = 0; c < classes; c++) gained[c] += row[c];
        }
        bool any = false;
        for (int c = 0; c < classes; c++) {
            any |= gained[c] != 0;
            if (how.leaks) leak(c, sums);
            else sums[c] += gained[c];
        }
        return any;
    }

private:
    const T* weights;
    const double* bias;
    const int heard, classes;  // heard: hidden neurons and, on a path past them, afferents
    const Integration how;
    double *gained, *y;

    NT_INLINE void leak(int c, Value* sums) {
        y[c] = how.decay * y[c] + gained[c];
        const double now = bias[c] + y[c];
        if (!how.peak || now > sums[c]) sums[c] = now;
    }
};

template <class T, class Readout>
struct InferState {
    using Value = typename Readout::Value;
    T *current, *membrane;
    T* adaptation;  // null where thresholds do not adapt
    SpikeHistory spikes;
    uint32_t *rows, *sent;
    Readout readout;

    InferState(const Net<T>& net, const ForwardTables<T>& tables, Carver& carver)
        : current(carver.take<T>(tables.hidden.pitch)), membrane(carver.take<T>(tables.hidden.pitch)),
          adaptation(net.adaptation.on ? carver.take<T>(tables.hidden.pitch) : nullptr),
          spikes(net.sizes.hidden, carver), rows(carve_rows(net.sizes.inputs + net.sizes.hidden, carver)), sent(rows),
          readout(net, tables, carver) {}
    void start(const Net<T>& net, const ForwardTables<T>& tables, Value* counts) {
        std::memset(current, 0, tables.hidden.pitch * sizeof(T));
        std::memset(membrane, 0, tables.hidden.pitch * sizeof(T));
        if (adaptation) std::memset(adaptation, 0, tables.hidden.pitch * sizeof(T));
        spikes.clear(net.sizes.hidden);
        readout.start(counts);
    }
    // Step `now` of a window, from 0, from the afferents that spike, of which the first `n_rows` of `rows` are the
    // numbers; how many hidden neurons spike, whose numbers `sent` then are. Adapts: whether their thresholds do.
    template <bool Adapts>
    NT_INLINE int step(const Net<T>& net, const ForwardTables<T>& tables, int n_rows, int64_t now, Leader<Value>& leader) {
        const int64_t hid_words = words(net.sizes.hidden);
        const int n_past = net.integration.direct ? n_rows : 0;
        if (net.w_rec)
            n_rows = list_rows(spikes.recurrent(net.neuron.recurrent_delay), hid_words, net.sizes.inputs, rows, n_rows);
        const LayerState<T> state{current, membrane, current, membrane, nullptr};
        if constexpr (Adapts)
            advance_layer<T>(net.neuron, tables.hidden, {tables.table, rows, n_rows, 0},
                             AdaptingState<T>{state, adaptation, spikes.now, nullptr, nullptr}, spikes.next);
        else
            advance_layer<T>(net.neuron, tables.hidden, {tables.table, rows, n_rows, 0}, state, spikes.next);
        const uint64_t* emitted = net.neuron.emits_at_once() ? spikes.next : spikes.now;
        for (int e = 0; e < n_past; e++) rows[e] += net.sizes.hidden;
        n_rows = list_rows(emitted, hid_words, 0, rows, n_past);
        const bool moved = readout.step(rows, n_rows, now, leader.sums);
        leader.after(moved, moved || readout.leaks());
        spikes.step();
        sent = rows + n_past;
        return n_rows - n_past;
    }
};

}  // namespace neurotact::NT_ISA
