// The forward step of a layer of any size: event-driven, a panel of neurons in registers at a time.
#pragma once

#include <type_traits>

#include "memory.hpp"
#include "spikes.hpp"
#include "step.hpp"

namespace neurotact::NT_ISA {

// Calls `run(at, N)` for panels of N vectors that cover `pitch` neurons from `at` on; N is a compile-time constant.
// Eight sums fit the registers of every instruction set.
template <class T, class Run>
NT_INLINE void each_panel(int pitch, const Run& run) {
    constexpr int L = kWide<T>;
    int at = 0;
    for (; at + 8 * L <= pitch; at += 8 * L) run(at, std::integral_constant<int, 8>());
    if (at + 4 * L <= pitch) run(at, std::integral_constant<int, 4>()), at += 4 * L;
    if constexpr (4 * L <= kPitch) return;
    if (at + 2 * L <= pitch) run(at, std::integral_constant<int, 2>()), at += 2 * L;
    if constexpr (2 * L <= kPitch) return;
    if (at < pitch) run(at, std::integral_constant<int, 1>());
}

// alpha, beta and threshold of every neuron, padded to whole vectors.
template <class T>
struct LayerTables {
    const T *alpha, *beta, *threshold;  // padded
    int neurons, pitch;
    T scale;
    Adaptation<T> adaptation;
};

template <class T>
LayerTables<T> pad_dynamics(const Dynamics<T>& from, int neurons, int pitch, Carver& carver,
                            const Adaptation<T>& adaptation = {}) {
    T* padded = carver.take<T>(3 * pitch);
    const T* values[3] = {from.alpha, from.beta, from.threshold};
    if (padded)
        for (int row = 0; row < 3; row++)
            for (int i = 0; i < pitch; i++)
                padded[row * pitch + i] = values[row][from.stride ? (i < neurons ? i : 0) : 0];
    return {padded, padded + pitch, padded + 2 * pitch, neurons, pitch, from.scale, adaptation};
}

template <class T>
void pad_rows(const T* from, int rows, int columns, int pitch, T* to) {
    for (int r = 0; r < rows; r++) {
        std::memcpy(to + (int64_t)r * pitch, from + (int64_t)r * columns, columns * sizeof(T));
        std::memset(to + (int64_t)r * pitch + columns, 0, (pitch - columns) * sizeof(T));
    }
}

// Numbers of the rows that have an event, ascending, into memory of `carve_rows`. On AVX-512 without a branch: how many of
// 64 neurons spike is what a processor cannot foresee.
NT_INLINE int list_rows(const uint64_t* events, int64_t n_words, uint32_t first, uint32_t* rows, int count) {
#if defined(__AVX512F__)
    const __m512i lane = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    for (int64_t k = 0; k < n_words; k++)
        for (int part = 0; part < 64; part += 16) {
            const __mmask16 spiking = (__mmask16)(events[k] >> part);
            const __m512i number = _mm512_add_epi32(lane, _mm512_set1_epi32((int)(first + 64 * k + part)));
            _mm512_storeu_si512(rows + count, _mm512_maskz_compress_epi32(spiking, number));
            count += __builtin_popcount(spiking);
        }
#else
    for (int64_t k = 0; k < n_words; k++)
        for (uint64_t m = events[k]; m; m &= m - 1) rows[count++] = first + (uint32_t)(64 * k) + lowest(m);
#endif
    return count;
}
// Memory for a list of up to `most` rows, and for the vector that is written behind its end.
inline uint32_t* carve_rows(int64_t most, Carver& carver) { return carver.take<uint32_t>(most + 16); }

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

// The moving state of a layer at step t and where that of step t+1 goes, which may be the same place.
template <class T>
struct LayerState {
    const T *current, *membrane;
    T *next_current, *next_membrane;
    T* counts;  // of the spikes s[1], s[2], ...; null where not wanted
};

// The same of a layer whose thresholds adapt. A kind of its own, so that the compiler leaves other layers as they are.
template <class T>
struct AdaptingState : LayerState<T> {
    T* adaptation;           // A[t], which becomes A[t+1]
    const uint64_t* spikes;  // s[t]
    T *compared, *raised;    // where U[t+1] - k A[t+1] and k A[t+1] go; null where they are not wanted
};
template <class State>
constexpr bool kAdapts = false;
template <class T>
constexpr bool kAdapts<AdaptingState<T>> = true;

// The events of a step: rows of `table`, numbered from `first` on.
template <class T>
struct EventRows {
    const T* table;
    const uint32_t* rows;
    int count;
    uint32_t first;
};

// A panel whose thresholds adapt, after its membrane: A[t] becomes A[t+1], and `membrane` U[t+1] - k A[t+1].
template <class T, int N>
NT_INLINE void adapt_panel(const LayerTables<T>& layer, const AdaptingState<T>& state, int at,
                           Vectors<Simd<T, kWide<T>>, N>& membrane) {
    using S = Simd<T, kWide<T>>;
    auto adaptation = load_all<S, N>(state.adaptation + at);
    typename S::Mask spiked[N];
    for (int q = 0; q < N; q++) {
        const int lane = at + q * S::lanes;
        spiked[q] = S::lanes_of(state.spikes[lane / 64] >> (lane % 64));
    }
    adaptation_step(layer.adaptation, adaptation, spiked);
    store_all(state.adaptation + at, adaptation);
    membrane = lowered(layer.adaptation, membrane, adaptation);
    if (state.compared) store_all(state.compared + at, membrane);
    if (!state.raised) return;
    for (int q = 0; q < N; q++) adaptation[q] = all<S>(layer.adaptation.strength) * adaptation[q];
    store_all(state.raised + at, adaptation);
}

template <class T, int N, class State>
NT_INLINE void advance_panel(Neuron neuron, const LayerTables<T>& layer, const EventRows<T>& events, int at,
                             const State& state, uint64_t* fired) {
    using S = Simd<T, kWide<T>>;
    Vectors<S, N> sum;
    for (int q = 0; q < N; q++)
        sum[q] = load<S>(layer.alpha + at + q * S::lanes) * load<S>(state.current + at + q * S::lanes);
    const T* table = events.table + at;
    for (int e = 0; e < events.count; e++) {
        const T* row = table + (int64_t)(events.rows[e] - events.first) * layer.pitch;
        for (int q = 0; q < N; q++) sum[q] += load<S>(row + q * S::lanes);
    }
    const auto before = load_all<S, N>(state.current + at);
    const auto threshold = load_all<S, N>(layer.threshold + at), beta = load_all<S, N>(layer.beta + at);
    auto membrane = load_all<S, N>(state.membrane + at);
    typename S::Mask above[N];
    if constexpr (kAdapts<State>) {
        const auto adaptation = load_all<S, N>(state.adaptation + at);
        const auto compared = lowered(layer.adaptation, membrane, adaptation);
        for (int q = 0; q < N; q++) above[q] = S::greater(compared[q], threshold[q]);
        membrane_step(neuron, membrane, before, sum, above, beta, raised(layer.adaptation, threshold, adaptation));
    } else {
        for (int q = 0; q < N; q++) above[q] = S::greater(membrane[q], threshold[q]);
        membrane_step(neuron, membrane, before, sum, above, beta, threshold);
    }
    store_all(state.next_current + at, sum);
    store_all(state.next_membrane + at, membrane);
    if constexpr (kAdapts<State>) adapt_panel<T, N>(layer, state, at, membrane);
    for (int q = 0; q < N; q++) {
        const int lane = at + q * S::lanes;
        const typename S::Mask spikes = S::greater(membrane[q], threshold[q]);
        fired[lane / 64] |= (uint64_t)S::bits(spikes) << (lane % 64);
        if (state.counts) {
            T* counts = state.counts + lane;
            store(counts, load<S>(counts) + S::only(spikes, typename S::V{} + 1));
        }
    }
}

// One step of a layer from its events; `fired` becomes its spikes.
template <class T, class State>
NT_INLINE void advance_layer(Neuron neuron, const LayerTables<T>& layer, const EventRows<T>& events,
                             const State& state, uint64_t* fired) {
    for (int64_t k = 0; k < words(layer.neurons); k++) fired[k] = 0;
    each_panel<T>(layer.pitch, [&](int at, auto N) __attribute__((always_inline)) {
        advance_panel<T, N.value>(neuron, layer, events, at, state, fired);
    });
    if (layer.neurons % 64) fired[layer.neurons / 64] &= (1ull << (layer.neurons % 64)) - 1;
}

// One step of a readout that leaks and does not spike: y[t+1] = decay y[t] + W s[t], in place.
template <class T>
NT_INLINE void leak_layer(T decay, int pitch, const EventRows<T>& events, T* y) {
    each_panel<T>(pitch, [&](int at, auto N) __attribute__((always_inline)) {
        using S = Simd<T, kWide<T>>;
        auto sum = load_all<S, N.value>(y + at);
        for (int q = 0; q < N.value; q++) sum[q] = all<S>(decay) * sum[q];
        for (int e = 0; e < events.count; e++) {
            const T* row = events.table + (int64_t)(events.rows[e] - events.first) * pitch + at;
            for (int q = 0; q < N.value; q++) sum[q] += load<S>(row + q * S::lanes);
        }
        store_all(y + at, sum);
    });
}

template <class T>
struct ForwardTables {
    LayerTables<T> hidden, readout;
    T* table;          // rows of w_in, then of w_rec
    T* readout_table;  // rows of w_out

    ForwardTables(const Net<T>& net, Carver& carver) {
        const Sizes& n = net.sizes;
        hidden = pad_dynamics(net.hidden, n.hidden, round_up(n.hidden, kPitch), carver, net.adaptation);
        const bool spikes = n.classes && !net.bias;
        readout = spikes ? pad_dynamics(net.readout, n.classes, round_up(n.classes, kPitch), carver) : LayerTables<T>{};
        table = carver.take<T>((int64_t)(n.inputs + n.hidden) * hidden.pitch);
        readout_table = carver.take<T>((int64_t)n.hidden * readout.pitch);
        if (!table) return;
        pad_rows(net.w_in, n.inputs, n.hidden, hidden.pitch, table);
        if (net.w_rec) pad_rows(net.w_rec, n.hidden, n.hidden, hidden.pitch, table + (int64_t)n.inputs * hidden.pitch);
        if (spikes) pad_rows(net.w_out, n.hidden, n.classes, readout.pitch, readout_table);
    }
};

}  // namespace neurotact::NT_ISA
