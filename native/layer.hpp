// The forward step of a layer of any size: event-driven, a panel of neurons in registers at a time.
#pragma once

#include "memory.hpp"
#include "spikes.hpp"
#include "step.hpp"

namespace neurotact::NT_ISA {

constexpr int kPanel = kVectorBytes == 64 ? 8 : 4;  // vectors of neurons in registers

// alpha, beta and threshold of every neuron, padded to whole vectors.
template <class T>
struct LayerTables {
    const T *alpha, *beta, *threshold;  // padded
    int neurons, pitch;
};

template <class T>
LayerTables<T> pad_dynamics(const Dynamics<T>& from, int neurons, int pitch, Carver& carver) {
    T* padded = carver.take<T>(3 * pitch);
    const T* values[3] = {from.alpha, from.beta, from.threshold};
    if (padded)
        for (int row = 0; row < 3; row++)
            for (int i = 0; i < pitch; i++)
                padded[row * pitch + i] = values[row][from.stride ? (i < neurons ? i : 0) : 0];
    return {padded, padded + pitch, padded + 2 * pitch, neurons, pitch};
}

template <class T>
void pad_rows(const T* from, int rows, int columns, int pitch, T* to) {
    for (int r = 0; r < rows; r++) {
        std::memcpy(to + (int64_t)r * pitch, from + (int64_t)r * columns, columns * sizeof(T));
        std::memset(to + (int64_t)r * pitch + columns, 0, (pitch - columns) * sizeof(T));
    }
}

// Numbers of the rows that have an event, ascending.
NT_INLINE int list_rows(const uint64_t* events, int64_t n_words, uint32_t first, uint32_t* rows, int count) {
    for (int64_t k = 0; k < n_words; k++)
        for (uint64_t m = events[k]; m; m &= m - 1) rows[count++] = first + (uint32_t)(64 * k) + lowest(m);
    return count;
}

// The spikes of a layer in the steps that it still needs: s[t+1], s[t] and s[t-1].
struct SpikeHistory {
    uint64_t *next, *now, *before;

    SpikeHistory(int neurons, Carver& carver)
        : next(carver.take<uint64_t>(words(neurons))), now(carver.take<uint64_t>(words(neurons))),
          before(carver.take<uint64_t>(words(neurons))) {}
    void clear(int neurons) {
        std::memset(now, 0, words(neurons) * sizeof(uint64_t));
        std::memset(before, 0, words(neurons) * sizeof(uint64_t));
    }
    // What comes back to the layer in step t: s[t-d].
    NT_INLINE const uint64_t* recurrent(int delay) const { return delay ? before : now; }
    NT_INLINE void step() {
        uint64_t* oldest = before;
        before = now;
        now = next;
        next = oldest;
    }
};

template <class T, Membrane M, Reset R, int N>
NT_INLINE void advance_panel(const LayerTables<T>& layer, const T* table, const uint32_t* rows, int n_rows, int at,
                             T* current, T* membrane, uint64_t* fired) {
    using S = Simd<T, kWide<T>>;
    using V = typename S::V;
    constexpr int L = S::lanes;
    V before[N], sum[N];
    for (int q = 0; q < N; q++) {
        before[q] = load<S>(current + at + q * L);
        sum[q] = load<S>(layer.alpha + at + q * L) * before[q];
    }
    for (int e = 0; e < n_rows; e++) {
        const T* row = table + (int64_t)rows[e] * layer.pitch + at;
        for (int q = 0; q < N; q++) sum[q] += load<S>(row + q * L);
    }
    for (int q = 0; q < N; q++) {
        const int lane = at + q * L;
        const V threshold = load<S>(layer.threshold + lane), old = load<S>(membrane + lane);
        const V next = membrane_step<S, M, R>(old, before[q], sum[q], S::greater(old, threshold),
                                              load<S>(layer.beta + lane), threshold);
        store(current + lane, sum[q]);
        store(membrane + lane, next);
        fired[lane / 64] |= (uint64_t)S::bits(S::greater(next, threshold)) << (lane % 64);
    }
}

// One step of a layer from the rows that spiked; `fired` becomes its spikes.
template <class T, Membrane M, Reset R>
NT_INLINE void advance_layer(const LayerTables<T>& layer, const T* table, const uint32_t* rows, int n_rows, T* current,
                             T* membrane, uint64_t* fired) {
    constexpr int L = kWide<T>;
    for (int64_t k = 0; k < words(layer.neurons); k++) fired[k] = 0;
    int at = 0;
    for (; at + kPanel * L <= layer.pitch; at += kPanel * L)
        advance_panel<T, M, R, kPanel>(layer, table, rows, n_rows, at, current, membrane, fired);
    for (; at + 2 * L <= layer.pitch; at += 2 * L)
        advance_panel<T, M, R, 2>(layer, table, rows, n_rows, at, current, membrane, fired);
    for (; at < layer.pitch; at += L)
        advance_panel<T, M, R, 1>(layer, table, rows, n_rows, at, current, membrane, fired);
    if (layer.neurons % 64) fired[layer.neurons / 64] &= (1ull << (layer.neurons % 64)) - 1;
}

template <class T>
struct ForwardTables {
    LayerTables<T> hidden, readout;
    T* table;          // rows of w_in, then of w_rec
    T* readout_table;  // rows of w_out

    ForwardTables(const Net<T>& net, const Layout& layout, Carver& carver) {
        const Sizes& n = net.sizes;
        hidden = pad_dynamics(net.hidden, n.hidden, layout.hidden_pitch, carver);
        readout = n.classes ? pad_dynamics(net.readout, n.classes, layout.readout_pitch, carver) : LayerTables<T>{};
        table = carver.take<T>((int64_t)(n.inputs + n.hidden) * hidden.pitch);
        readout_table = carver.take<T>((int64_t)n.hidden * readout.pitch);
        if (!table) return;
        pad_rows(net.w_in, n.inputs, n.hidden, hidden.pitch, table);
        if (net.w_rec) pad_rows(net.w_rec, n.hidden, n.hidden, hidden.pitch, table + (int64_t)n.inputs * hidden.pitch);
        if (n.classes) pad_rows(net.w_out, n.hidden, n.classes, readout.pitch, readout_table);
    }
};

}  // namespace neurotact::NT_ISA
