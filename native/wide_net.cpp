// Networks and layers of any size. Forward: each trial by itself, event-driven, a panel of neurons in registers at a
// time. Backward: blocks of trials side by side, so that the one dense product of a step, dL/ds = dL/dI V^T, is a
// matrix product; weight gradients are gathered from the events of a few steps at once.
#include "parallel.h"

#include "dispatch.hpp"
#include "layer.hpp"

namespace neurotact::NT_ISA {
namespace {

constexpr int kBlock = 16;                          // trials side by side, backward
constexpr int kAhead = 4;                           // steps, forward, between asking for a row of the tape and writing it
constexpr int kChunk = 16;                          // steps between two gatherings of weight gradients
constexpr int kTileRows = kVectorBytes == 64 ? 8 : 4;
constexpr int kTileVectors = kVectorBytes == 64 ? 3 : 2;

// ---- forward -------------------------------------------------------------------------------------------------------

// One layer of one trial: its state where no tape takes it, its counts and spikes.
template <class T>
struct ForwardLayer {
    T *current, *membrane, *counts;
    int neurons, pitch;

    ForwardLayer(int neurons, int pitch, Carver& carver)
        : current(carver.take<T>(pitch)), membrane(carver.take<T>(pitch)), counts(carver.take<T>(pitch)),
          neurons(neurons), pitch(pitch) {}
    void clear() {
        std::memset(current, 0, pitch * sizeof(T));
        std::memset(membrane, 0, pitch * sizeof(T));
        std::memset(counts, 0, pitch * sizeof(T));
    }
    // The state at step t, in the tape but for its first step: rows of the trial's tape, null where it has none.
    NT_INLINE LayerState<T> at(int64_t t, T* tape_membrane, T* tape_current) const {
        LayerState<T> state{current, membrane, current, membrane, counts};
        if (tape_membrane) {
            if (t) state.membrane = tape_membrane + (t - 1) * pitch;
            state.next_membrane = tape_membrane + t * pitch;
        }
        if (tape_current) {
            if (t) state.current = tape_current + (t - 1) * pitch;
            state.next_current = tape_current + t * pitch;
        }
        return state;
    }
    // Of a readout that leaks, `membrane` is its value and `counts` the step after which it was taken, the earliest of
    // equal ones: the largest so far, else the last.
    void take(bool peak, int64_t step) {
        for (int i = 0; i < pitch; i++) {
            if (peak && !(current[i] > membrane[i])) continue;
            membrane[i] = current[i];
            counts[i] = (T)step;
        }
    }
    // Counts of the spikes that were sent: all, or all but the last ones.
    void write(const uint64_t* but, T* to) const {
        for (int i = 0; i < neurons; i++) to[i] = counts[i] - bit(but, i);
    }
    // The same of a stretch that ends here; from now on the next one counts.
    void next_stretch(const uint64_t* but, T* to) {
        if (to) write(but, to);
        for (int i = 0; i < neurons; i++) counts[i] = bit(but, i);
    }
    static T bit(const uint64_t* of, int i) { return of ? (T)(of[i / 64] >> (i % 64) & 1) : T(0); }
};

template <class T>
struct TrialState {
    ForwardLayer<T> hidden, readout;
    SpikeHistory spikes;
    uint64_t *inputs, *decided;
    uint32_t *rows, *sent;
    T* adaptation;  // of the hidden layer, null where its thresholds do not adapt

    TrialState(const Sizes& n, const Layout& layout, bool adapts, Carver& carver)
        : hidden(n.hidden, layout.hidden_pitch, carver), readout(n.classes, layout.readout_pitch, carver),
          spikes(n.hidden, carver), inputs(carver.take<uint64_t>(words(n.inputs))),
          decided(carver.take<uint64_t>(words(n.classes) + 1)), rows(carve_rows(n.inputs + n.hidden, carver)),
          sent(carve_rows(n.hidden, carver)), adaptation(adapts ? carver.take<T>(layout.hidden_pitch) : nullptr) {}
    void clear() {
        hidden.clear();
        readout.clear();
        spikes.clear(hidden.neurons);
    }
    // The hidden layer at step t where its thresholds adapt: the membrane stays here, as the tape takes another value.
    AdaptingState<T> adapting_at(int64_t t, T* tape_membrane, T* tape_current, T* tape_raised) const {
        return {hidden.at(t, nullptr, tape_current), adaptation, spikes.now,
                tape_membrane ? tape_membrane + t * hidden.pitch : nullptr,
                tape_raised ? tape_raised + t * hidden.pitch : nullptr};
    }
};

// Whether the spikes of a step that come back to the layer are those that it sends out: one list of events serves both.
template <class T>
bool returns_what_it_sends(const Net<T>& net) {
    return net.w_rec && !net.neuron.emits_at_once() && !net.neuron.recurrent_delay;
}

template <class T, bool Adapts>
bool forward_trial(const Net<T>& net, const ForwardTables<T>& tables, TrialState<T>& s, int64_t trial,
                   const Outputs<T>& out, const Tape<T>* tape) {
    const Sizes& n = net.sizes;
    const Neuron neuron = net.neuron;
    const int64_t in_words = words(n.inputs), hid_words = words(n.hidden);
    const bool at_once = neuron.emits_at_once(), one_list = returns_what_it_sends(net);
    const bool leaks = net.integration.leaks;
    const auto row_of = [&](T* part, int pitch) { return part ? part + trial * n.steps * pitch : nullptr; };
    T* membrane = row_of(tape ? tape->membrane : nullptr, s.hidden.pitch);
    T* current = row_of(tape ? tape->current : nullptr, s.hidden.pitch);
    T* readout_membrane = row_of(tape ? tape->readout_membrane : nullptr, s.readout.pitch);
    T* readout_current = row_of(tape ? tape->readout_current : nullptr, s.readout.pitch);
    const auto counts_at = [&](int64_t step) {
        const int64_t row = trial * net.integration.stretches + net.integration.stretch_of(step);
        return out.hidden ? out.hidden + row * n.hidden : nullptr;
    };
    bool binary = true;
    s.clear();
    if constexpr (Adapts) std::memset(s.adaptation, 0, s.hidden.pitch * sizeof(T));
    for (int64_t t = 0; t < n.steps; t++) {
        const int64_t row = trial * n.steps + t;
        uint64_t* inputs = tape ? tape->inputs + row * in_words : s.inputs;
        binary &= pack_step(net.spikes, trial, t, n.inputs, inputs);
        const int n_in = list_rows(inputs, in_words, 0, s.rows, 0);
        const int n_rows = !net.w_rec ? n_in
                                      : list_rows(s.spikes.recurrent(neuron.recurrent_delay), hid_words, n.inputs,
                                                  s.rows, n_in);
        if (membrane) fetch<true>(membrane + (t + kAhead) * s.hidden.pitch, s.hidden.pitch);
        if (readout_membrane) fetch<true>(readout_membrane + (t + kAhead) * s.readout.pitch, s.readout.pitch);
        if constexpr (Adapts)
            advance_layer<T>(neuron, tables.hidden, {tables.table, s.rows, n_rows, 0},
                             s.adapting_at(t, membrane, current, row_of(tape ? tape->raised : nullptr, s.hidden.pitch)),
                             s.spikes.next);
        else
            advance_layer<T>(neuron, tables.hidden, {tables.table, s.rows, n_rows, 0},
                             s.hidden.at(t, membrane, current), s.spikes.next);
        const uint64_t* emitted = at_once ? s.spikes.next : s.spikes.now;
        if (out.raster) {
            T* line = out.raster + row * n.hidden;
            for (int i = 0; i < n.hidden; i++) line[i] = (T)(emitted[i / 64] >> (i % 64) & 1);
        }
        if (n.classes) {
            EventRows<T> sent{tables.readout_table, s.rows + n_in, n_rows - n_in, (uint32_t)n.inputs};
            if (!one_list) sent = {tables.readout_table, s.sent, list_rows(emitted, hid_words, 0, s.sent, 0), 0};
            if (leaks) {
                leak_layer((T)net.integration.decay, s.readout.pitch, sent, s.readout.current);
                s.readout.take(net.integration.peak, t + 1);
            } else {
                advance_layer(neuron, tables.readout, sent, s.readout.at(t, readout_membrane, readout_current), s.decided);
            }
        }
        if (tape)
            for (int64_t k = 0; k < hid_words; k++) tape->spikes[row * hid_words + k] = s.spikes.next[k];
        s.spikes.step();
        if (net.integration.ends(t) && t < n.steps - 1)
            s.hidden.next_stretch(at_once ? nullptr : s.spikes.now, counts_at(t));
    }
    const bool all_sent = at_once || n.steps == 0;
    if (out.hidden) s.hidden.write(all_sent ? nullptr : s.spikes.now, counts_at(n.steps ? n.steps - 1 : 0));
    if (leaks) {
        if (out.readout) std::memcpy(out.readout + trial * n.classes, s.readout.membrane, n.classes * sizeof(T));
        if (tape) std::memcpy(tape->taken + trial * s.readout.pitch, s.readout.counts, s.readout.pitch * sizeof(T));
    } else if (out.readout) {
        s.readout.write(all_sent ? nullptr : s.decided, out.readout + trial * n.classes);
    }
    return binary;
}

// ---- backward ------------------------------------------------------------------------------------------------------

// A matrix (n_in, n_out) cut into panels of kTileVectors vectors of columns, so that a tile reads it in one stream.
template <class T>
struct Panels {
    T* data;
    int n_in, pitch;  // rows; columns, padded

    // to[i][o] = from[o][i]
    static Panels transposed(const T* from, int n_out, int n_in, Carver& carver) {
        constexpr int L = kWide<T>;
        const int pitch = round_up(n_out, 16);
        Panels panels{carver.take<T>((int64_t)n_in * pitch), n_in, pitch};
        if (!panels.data || !from) return panels;
        T* to = panels.data;
        for (int at = 0; at < pitch;) {
            const int width = at + kTileVectors * L <= pitch ? kTileVectors * L : L;
            for (int i = 0; i < n_in; i++)
                for (int c = 0; c < width; c++) *to++ = at + c < n_out ? from[(int64_t)(at + c) * n_in + i] : T(0);
            at += width;
        }
        return panels;
    }
};

// out[m][o] += sum over i ascending of g[m][i] matrix[i][o], for MR rows and NV vectors of columns.
template <class T, int MR, int NV>
NT_INLINE void product_tile(const T* g, int g_pitch, const T* panel, int n_in, T* out, int out_pitch) {
    using S = Simd<T, kWide<T>>;
    using V = typename S::V;
    constexpr int L = S::lanes;
    V sum[MR][NV];
    for (int m = 0; m < MR; m++)
        for (int q = 0; q < NV; q++) sum[m][q] = V{};
    for (int i = 0; i < n_in; i++) {
        V w[NV];
        for (int q = 0; q < NV; q++) w[q] = load<S>(panel + ((int64_t)i * NV + q) * L);
        for (int m = 0; m < MR; m++) {
            const V factor = all<S>(g[(int64_t)m * g_pitch + i]);
            for (int q = 0; q < NV; q++) sum[m][q] += factor * w[q];
        }
    }
    for (int m = 0; m < MR; m++)
        for (int q = 0; q < NV; q++) {
            T* at = out + (int64_t)m * out_pitch + q * L;
            store(at, load<S>(at) + sum[m][q]);
        }
}

template <class T, int NV>
NT_INLINE void product_panel(const T* g, int g_pitch, const T* panel, int n_in, T* out, int out_pitch, int rows) {
    int m = 0;
    for (; m + kTileRows <= rows; m += kTileRows)
        product_tile<T, kTileRows, NV>(g + m * g_pitch, g_pitch, panel, n_in, out + m * out_pitch, out_pitch);
    for (; m + 2 <= rows; m += 2)
        product_tile<T, 2, NV>(g + m * g_pitch, g_pitch, panel, n_in, out + m * out_pitch, out_pitch);
    for (; m < rows; m++)
        product_tile<T, 1, NV>(g + m * g_pitch, g_pitch, panel, n_in, out + m * out_pitch, out_pitch);
}

// out (rows, pitch) += g (rows, n_in) matrix
template <class T>
void add_product(const T* g, int g_pitch, const Panels<T>& matrix, T* out, int rows) {
    constexpr int L = kWide<T>;
    for (int at = 0; at < matrix.pitch;) {
        const T* panel = matrix.data + (int64_t)at * matrix.n_in;
        if (at + kTileVectors * L <= matrix.pitch) {
            product_panel<T, kTileVectors>(g, g_pitch, panel, matrix.n_in, out + at, matrix.pitch, rows);
            at += kTileVectors * L;
        } else {
            product_panel<T, 1>(g, g_pitch, panel, matrix.n_in, out + at, matrix.pitch, rows);
            at += L;
        }
    }
}

// The events of a few steps of a block of trials, sorted by presynaptic neuron; a slot is a (step, trial).
struct EventLists {
    uint16_t* slots;  // (neuron, kChunk * kBlock)
    uint32_t* counts;
    int neurons;

    EventLists(int n, Carver& carver) : neurons(n) {
        slots = carver.take<uint16_t>((int64_t)n * kChunk * kBlock);
        counts = carver.take<uint32_t>(n);
    }
    void clear() { std::memset(counts, 0, neurons * sizeof(uint32_t)); }
    NT_INLINE void add(const uint32_t* rows, int n_rows, int slot) {
        for (int e = 0; e < n_rows; e++)
            slots[(int64_t)rows[e] * kChunk * kBlock + counts[rows[e]]++] = (uint16_t)slot;
    }
};

template <class T, int N>
NT_INLINE void gather_panel(const uint16_t* slots, int count, const T* history, int pitch, T* sum_at) {
    using S = Simd<T, kWide<T>>;
    constexpr int L = S::lanes;
    typename S::V sum[N];
    for (int q = 0; q < N; q++) sum[q] = load<S>(sum_at + q * L);
    for (int e = 0; e < count; e++) {
        const T* line = history + (int64_t)slots[e] * pitch;
        for (int q = 0; q < N; q++) sum[q] += load<S>(line + q * L);
    }
    for (int q = 0; q < N; q++) store(sum_at + q * L, sum[q]);
}

// sums[j] += dL/dI of every slot at which neuron j, counted from `first` on, had spiked
template <class T>
void gather(const EventLists& events, int first, const T* history, int pitch, T* sums) {
    for (int j = 0; first + j < events.neurons; j++) {
        const int count = (int)events.counts[first + j];
        if (count == 0) continue;
        const uint16_t* slots = events.slots + (int64_t)(first + j) * kChunk * kBlock;
        T* sum = sums + (int64_t)j * pitch;
        each_panel<T>(pitch, [&](int at, auto N) __attribute__((always_inline)) {
            gather_panel<T, N.value>(slots, count, history + at, pitch, sum + at);
        });
    }
}

template <class T>
struct BackwardTables {
    LayerTables<T> hidden, readout;
    Panels<T> recurrent, out, in;

    BackwardTables(const Net<T>& net, const Layout& layout, bool with_inputs, Carver& carver) {
        const Sizes& n = net.sizes;
        hidden = pad_dynamics(net.hidden, n.hidden, layout.hidden_pitch, carver, net.adaptation);
        readout = n.classes ? pad_dynamics(net.readout, n.classes, layout.readout_pitch, carver) : LayerTables<T>{};
        recurrent = net.w_rec ? Panels<T>::transposed(net.w_rec, n.hidden, n.hidden, carver) : Panels<T>{};
        out = n.classes ? Panels<T>::transposed(net.w_out, n.hidden, n.classes, carver) : Panels<T>{};
        in = with_inputs ? Panels<T>::transposed(net.w_in, n.inputs, n.hidden, carver) : Panels<T>{};
    }
};

// Sums over a group of trials; groups are added in their order, whatever thread did them.
template <class T>
struct Sums {
    T *w_in, *w_rec, *w_out;                // w_rec lies behind w_in
    T *hidden_dynamics, *readout_dynamics;  // alpha, beta, threshold rows
    Sums(const Net<T>& net, const Layout& layout, Carver& carver) {
        const Sizes& n = net.sizes;
        w_in = carver.take<T>((int64_t)(n.inputs + (net.w_rec ? n.hidden : 0)) * layout.hidden_pitch);
        w_rec = w_in + (int64_t)n.inputs * layout.hidden_pitch;
        w_out = carver.take<T>((int64_t)n.hidden * layout.readout_pitch);
        hidden_dynamics = carver.take<T>(3 * layout.hidden_pitch);
        readout_dynamics = carver.take<T>(3 * layout.readout_pitch);
    }
};

// What a thread works with: one block of trials.
template <class T>
struct BlockState {
    T *current, *membrane, *emitted;                  // adjoints (trial, pitch): of I, of U and of s
    T* adaptation;                                    // and of A, null where thresholds do not adapt
    T *readout_current, *readout_membrane;
    T *history, *readout_history;                     // complete dL/dI[t+1], (slot, pitch)
    T *count_gradient, *class_gradient;               // dL/d(counts) of the two layers, (trial, pitch)
    T* unheard;                                       // dL/ds of a readout spike that comes too late
    T* input_gradient;
    uint64_t* silent;                                 // the spikes before the first step
    uint32_t* rows;
    EventLists arriving, sent;                        // arriving: inputs, then what comes back to the layer

    BlockState(const Net<T>& net, const Layout& layout, Carver& carver)
        : current(carver.take<T>(kBlock * layout.hidden_pitch)),
          membrane(carver.take<T>(kBlock * layout.hidden_pitch)),
          emitted(carver.take<T>(kBlock * layout.hidden_pitch)),
          adaptation(net.adaptation.on ? carver.take<T>(kBlock * layout.hidden_pitch) : nullptr),
          readout_current(carver.take<T>(kBlock * layout.readout_pitch)),
          readout_membrane(carver.take<T>(kBlock * layout.readout_pitch)),
          history(carver.take<T>((int64_t)kChunk * kBlock * layout.hidden_pitch)),
          readout_history(carver.take<T>((int64_t)kChunk * kBlock * layout.readout_pitch)),
          count_gradient(carver.take<T>(kBlock * layout.hidden_pitch)),
          class_gradient(carver.take<T>(kBlock * layout.readout_pitch)),
          unheard(carver.take<T>(layout.readout_pitch)),
          input_gradient(carver.take<T>(kBlock * round_up(net.sizes.inputs, 16))),
          silent(carver.take<uint64_t>(words(net.sizes.hidden))),
          rows(carve_rows(net.sizes.inputs + net.sizes.hidden, carver)),
          arriving(net.sizes.inputs + (net.w_rec ? net.sizes.hidden : 0), carver),
          sent(net.sizes.classes ? net.sizes.hidden : 0, carver) {}
};

// Where one layer of one trial stands: row t of its tape, and its part of the block's state.
template <class T>
struct LayerRow {
    const T *membrane, *current;  // of the tape; current is null where no dynamics are learned
    const T* spike_gradient;      // dL/ds[t+1], but for what comes through A[t+2]
    T *adjoint_current, *adjoint_membrane;
    T* complete;                  // dL/dI[t+1] goes there
    T* adjoint_adaptation = nullptr;  // only where thresholds adapt
    const T* raised = nullptr;        // of the tape, likewise and where dynamics are learned
};

template <class T, int N, bool Adapts>
NT_INLINE void panel_back(Neuron neuron, const LayerTables<T>& layer, const LayerRow<T>& row, bool first, int at, T* sums) {
    using S = Simd<T, kWide<T>>;
    const auto threshold = load_all<S, N>(layer.threshold + at), after = load_all<S, N>(row.membrane + at);
    auto spike_gradient = load_all<S, N>(row.spike_gradient + at);
    Vectors<S, N> adaptation{};
    if constexpr (Adapts) {
        adaptation = load_all<S, N>(row.adjoint_adaptation + at);
        for (int q = 0; q < N; q++) spike_gradient[q] = spike_gradient[q] + adaptation[q];
    }
    const auto scale = all<S>(layer.scale);
    Vectors<S, N> before{}, sloped;
    if (!first) before = load_all<S, N>(row.membrane - layer.pitch + at);
    typename S::Mask fired[N];
    for (int q = 0; q < N; q++) {
        fired[q] = S::greater(before[q], threshold[q]);
        sloped[q] = surrogate_slope<S>(after[q], threshold[q], scale) * spike_gradient[q];
    }
    if constexpr (Adapts) {
        adaptation_back(layer.adaptation, adaptation, sloped);
        store_all(row.adjoint_adaptation + at, adaptation);
    }
    Adjoint<S, N> adjoint{load_all<S, N>(row.adjoint_current + at), load_all<S, N>(row.adjoint_membrane + at)};
    const auto gradient = step_back(neuron, adjoint, sloped, fired, load_all<S, N>(layer.alpha + at),
                                    load_all<S, N>(layer.beta + at));
    store_all(row.adjoint_current + at, adjoint.current);
    store_all(row.adjoint_membrane + at, adjoint.membrane);
    store_all(row.complete + at, gradient.current);
    if (!sums) return;
    Vectors<S, N> current_before{};
    if (!first && row.current) current_before = load_all<S, N>(row.current - layer.pitch + at);
    if (Adapts && !first && row.raised)  // U[t] from U[t] - k A[t]
        for (int q = 0; q < N; q++) before[q] = before[q] + load<S>(row.raised - layer.pitch + at + q * S::lanes);
    add_dynamics(neuron, gradient, sloped, before, current_before, fired, sums + at, layer.pitch);
}

// Step t of one layer of one trial, backwards.
template <class T>
NT_INLINE void layer_back(Neuron neuron, const LayerTables<T>& layer, const LayerRow<T>& row, bool first, T* sums) {
    const auto each = [&](auto adapts) __attribute__((always_inline)) {
        constexpr int L = kWide<T>;
        int at = 0;
        for (; at + 2 * L <= layer.pitch; at += 2 * L)
            panel_back<T, 2, adapts.value>(neuron, layer, row, first, at, sums);
        for (; at < layer.pitch; at += L) panel_back<T, 1, adapts.value>(neuron, layer, row, first, at, sums);
    };
    if (row.adjoint_adaptation) each(std::true_type());
    else each(std::false_type());
}

// The gradients of one block of trials, step by step from the last.
template <class T>
class BlockBack {
public:
    BlockBack(const Net<T>& net, const BackwardTables<T>& tables, const Tape<T>& tape, const Gradients<T>& grad,
              BlockState<T>& state, Sums<T>& sums, int64_t first_trial, int trials)
        : net(net), n(net.sizes), tables(tables), tape(tape), grad(grad), s(state), sums(sums),
          first_trial(first_trial), trials(trials), pitch(tables.hidden.pitch), readout_pitch(tables.readout.pitch),
          in_words(words(n.inputs)), hid_words(words(n.hidden)), one_list(returns_what_it_sends(net)) {}

    void run() {
        start();
        for (int64_t t = n.steps - 1; t >= 0; t--) {
            T* history = s.history + (int64_t)filled * kBlock * pitch;
            T* readout_history = s.readout_history + (int64_t)filled * kBlock * readout_pitch;
            if (n.classes) readout_back(t, readout_history);
            if (net.neuron.emits_at_once()) add_emission(t, readout_history);
            hidden_back(t, history);
            start_spike_gradient(t - net.neuron.emits_at_once());
            // dL/ds[t] through what comes back to the layer: in I[t+1+d]
            const T* returning = net.neuron.recurrent_delay ? later : history;
            if (net.w_rec && returning) add_product(returning, pitch, tables.recurrent, s.emitted, trials);
            later = history;
            if (!net.neuron.emits_at_once()) add_emission(t, readout_history);
            if (grad.spikes) write_input_gradient(t, history);
            if (++filled == kChunk || t == 0) gather_weights();
        }
    }

private:
    const Net<T>& net;
    const Sizes& n;
    const BackwardTables<T>& tables;
    const Tape<T>& tape;
    const Gradients<T>& grad;
    BlockState<T>& s;
    Sums<T>& sums;
    const int64_t first_trial;
    const int trials, pitch, readout_pitch;
    const int64_t in_words, hid_words;
    const bool one_list;
    int filled = 0;            // steps in the history
    int64_t stretch = -1;      // whose counts' gradient is in use
    const T* later = nullptr;  // the history of step t+1

    static void clear(T* at, int64_t count) { std::memset(at, 0, count * sizeof(T)); }
    static void copy_rows(const T* from, int rows, int columns, T* to, int pitch) {
        clear(to, (int64_t)rows * pitch);
        if (!from) return;
        for (int m = 0; m < rows; m++)
            std::memcpy(to + (int64_t)m * pitch, from + (int64_t)m * columns, columns * sizeof(T));
    }
    void start() {
        clear(s.current, (int64_t)trials * pitch);
        clear(s.membrane, (int64_t)trials * pitch);
        if (s.adaptation) clear(s.adaptation, (int64_t)trials * pitch);
        clear(s.readout_current, (int64_t)trials * readout_pitch);
        clear(s.readout_membrane, (int64_t)trials * readout_pitch);
        clear(s.unheard, readout_pitch);
        std::memset(s.silent, 0, hid_words * sizeof(uint64_t));
        stretch = -1;
        if (!grad.hidden) clear(s.count_gradient, (int64_t)trials * pitch);
        copy_rows(grad.readout ? grad.readout + first_trial * n.classes : nullptr, trials, n.classes, s.class_gradient,
                  readout_pitch);
        // s[T] is sent only where step T-1 emits it.
        if (net.neuron.emits_at_once()) start_spike_gradient(n.steps - 1);
        else clear(s.emitted, (int64_t)trials * pitch);
        s.arriving.clear(), s.sent.clear();
    }
    // dL/ds through what the layer sends out at this step: its share of the counts
    void start_spike_gradient(int64_t step) {
        const int64_t now = net.integration.stretch_of(step < 0 ? 0 : step), columns = net.integration.stretches * n.hidden;
        if (grad.hidden && now != stretch)
            for (int m = 0; m < trials; m++) {
                T* to = s.count_gradient + (int64_t)m * pitch;
                clear(to, pitch);
                std::memcpy(to, grad.hidden + (first_trial + m) * columns + now * n.hidden, n.hidden * sizeof(T));
            }
        stretch = now;
        std::memcpy(s.emitted, s.count_gradient, (int64_t)trials * pitch * sizeof(T));
    }
    // and of the raster and of the readout's input at step t
    void add_emission(int64_t t, const T* readout_history) {
        if (grad.raster)
            for (int m = 0; m < trials; m++) {
                const T* from = grad.raster + ((first_trial + m) * n.steps + t) * n.hidden;
                T* to = s.emitted + (int64_t)m * pitch;
                for (int i = 0; i < n.hidden; i++) to[i] += from[i];
            }
        if (n.classes) add_product(readout_history, readout_pitch, tables.out, s.emitted, trials);
    }
    // A value that was taken after step t hands its gradient to y[t+1].
    void leak_back(int64_t t, T* history) {
        const T decay = (T)net.integration.decay;
        for (int m = 0; m < trials; m++) {
            const int64_t at = (int64_t)m * readout_pitch;
            const T* taken = tape.taken + (first_trial + m) * readout_pitch;
            T *carried = s.readout_current + at, *complete = history + at;
            for (int c = 0; c < readout_pitch; c++) {
                complete[c] = carried[c] + (taken[c] == (T)(t + 1) ? s.class_gradient[at + c] : T(0));
                carried[c] = decay * complete[c];
            }
        }
    }
    void readout_back(int64_t t, T* history) {
        if (net.integration.leaks) return leak_back(t, history);
        const bool heard = net.neuron.emits_at_once() || t + 1 < n.steps;
        for (int m = 0; m < trials; m++) {
            const int64_t row = ((first_trial + m) * n.steps + t) * readout_pitch, at = (int64_t)m * readout_pitch;
            fetch(tape.readout_membrane + row - 2 * readout_pitch, readout_pitch);
            layer_back(net.neuron, tables.readout,
                       {tape.readout_membrane + row, tape.readout_current ? tape.readout_current + row : nullptr,
                        heard ? s.class_gradient + at : s.unheard, s.readout_current + at, s.readout_membrane + at,
                        history + at},
                       t == 0, grad.dynamics ? sums.readout_dynamics : nullptr);
        }
    }
    const uint64_t* spikes_of(int64_t trial, int64_t step) const {  // s[step]
        return step > 0 ? tape.spikes + (trial * n.steps + step - 1) * hid_words : s.silent;
    }
    void hidden_back(int64_t t, T* history) {
        for (int m = 0; m < trials; m++) {
            const int64_t trial = first_trial + m, row = trial * n.steps + t, at = (int64_t)m * pitch;
            fetch(tape.membrane + (row - 2) * pitch, pitch);  // for step t-1, a block of trials later
            layer_back(net.neuron, tables.hidden,
                       {tape.membrane + row * pitch, tape.current ? tape.current + row * pitch : nullptr, s.emitted + at,
                        s.current + at, s.membrane + at, history + at, s.adaptation ? s.adaptation + at : nullptr,
                        tape.raised ? tape.raised + row * pitch : nullptr},
                       t == 0, grad.dynamics ? sums.hidden_dynamics : nullptr);
            const int slot = filled * kBlock + m;
            const auto list = [&](const uint64_t* spikes, int first, int count) __attribute__((always_inline)) {
                return list_rows(spikes, hid_words, first, s.rows, count);
            };
            int n_rows = list_rows(tape.inputs + row * in_words, in_words, 0, s.rows, 0);
            if (net.w_rec) n_rows = list(spikes_of(trial, t - net.neuron.recurrent_delay), n.inputs, n_rows);
            s.arriving.add(s.rows, n_rows, slot);
            if (n.classes && !one_list)
                s.sent.add(s.rows, list(spikes_of(trial, t + net.neuron.emits_at_once()), 0, 0), slot);
        }
    }
    void write_input_gradient(int64_t t, const T* history) {
        clear(s.input_gradient, (int64_t)trials * tables.in.pitch);
        add_product(history, pitch, tables.in, s.input_gradient, trials);
        for (int m = 0; m < trials; m++)
            std::memcpy(grad.spikes + ((first_trial + m) * n.steps + t) * n.inputs,
                        s.input_gradient + (int64_t)m * tables.in.pitch, n.inputs * sizeof(T));
    }
    void gather_weights() {
        gather(s.arriving, 0, s.history, pitch, sums.w_in);
        if (n.classes)
            gather(one_list ? s.arriving : s.sent, one_list ? n.inputs : 0, s.readout_history, readout_pitch, sums.w_out);
        s.arriving.clear(), s.sent.clear();
        filled = 0;
    }
};

}  // namespace

template <class T>
bool wide_forward(const Net<T>& net, const Layout& layout, const Outputs<T>& out, const Tape<T>* tape) {
    Carver measure, thread_measure;
    ForwardTables<T>(net, measure);
    TrialState<T>(net.sizes, layout, net.adaptation.on, thread_measure);
    Block block(measure.bytes() + net.threads * thread_measure.bytes());
    Carver carver(block.data());
    const ForwardTables<T> tables(net, carver);
    char* thread_memory = block.data() + measure.bytes();
    const auto run = net.adaptation.on ? forward_trial<T, true> : forward_trial<T, false>;
    int others = 0;
#pragma omp parallel num_threads(net.threads) reduction(+ : others)
    {
        Carver mine(thread_memory + omp_get_thread_num() * thread_measure.bytes());
        TrialState<T> state(net.sizes, layout, net.adaptation.on, mine);
#pragma omp for schedule(dynamic, 4)
        for (int64_t trial = 0; trial < net.sizes.trials; trial++)
            others += !run(net, tables, state, trial, out, tape);
    }
    return others == 0;
}

template <class T>
void wide_backward(const Net<T>& net, const Layout& layout, const Tape<T>& tape, const Gradients<T>& grad) {
    const Sizes& n = net.sizes;
    const int64_t blocks = (n.trials + kBlock - 1) / kBlock;
    const int groups = (int)(blocks < kWideGroups ? blocks : kWideGroups);
    Carver measure, thread_measure, sums_measure;
    BackwardTables<T>(net, layout, grad.spikes != nullptr, measure);
    BlockState<T>(net, layout, thread_measure);
    Sums<T>(net, layout, sums_measure);
    Block block(measure.bytes() + net.threads * thread_measure.bytes() + groups * sums_measure.bytes());
    Carver carver(block.data());
    const BackwardTables<T> tables(net, layout, grad.spikes != nullptr, carver);
    char* thread_memory = block.data() + measure.bytes();
    char* sums_memory = thread_memory + net.threads * thread_measure.bytes();
    const auto sums_of = [&](int group) {
        Carver at(sums_memory + group * sums_measure.bytes());
        return Sums<T>(net, layout, at);
    };
#pragma omp parallel num_threads(net.threads)
    {
        Carver mine(thread_memory + omp_get_thread_num() * thread_measure.bytes());
        BlockState<T> state(net, layout, mine);
#pragma omp for schedule(dynamic, 1)
        for (int group = 0; group < groups; group++) {
            Sums<T> sums = sums_of(group);
            std::memset(sums_memory + group * sums_measure.bytes(), 0, sums_measure.bytes());
            for (int64_t k = blocks * group / groups; k < blocks * (group + 1) / groups; k++) {
                const int64_t first = k * kBlock, left = n.trials - first;
                BlockBack<T>(net, tables, tape, grad, state, sums, first, left < kBlock ? (int)left : kBlock).run();
            }
        }
        // The parts of each parameter, added group after group.
        const auto add_up = [&](T* Sums<T>::*part, int pitch, int rows, int columns, T* to) {
            if (to == nullptr) return;
#pragma omp for schedule(static) nowait
            for (int r = 0; r < rows; r++) {
                T* line = to + (int64_t)r * columns;
                for (int c = 0; c < columns; c++) line[c] = 0;
                for (int group = 0; group < groups; group++) {
                    const T* from = sums_of(group).*part + (int64_t)r * pitch;
                    for (int c = 0; c < columns; c++) line[c] += from[c];
                }
            }
        };
        add_up(&Sums<T>::w_in, layout.hidden_pitch, n.inputs, n.hidden, grad.w_in);
        add_up(&Sums<T>::w_rec, layout.hidden_pitch, n.hidden, n.hidden, net.w_rec ? grad.w_rec : nullptr);
        add_up(&Sums<T>::w_out, layout.readout_pitch, n.hidden, n.classes, n.classes ? grad.w_out : nullptr);
        add_up(&Sums<T>::hidden_dynamics, layout.hidden_pitch, 3, n.hidden, grad.dynamics);
        add_up(&Sums<T>::readout_dynamics, layout.readout_pitch, 3, n.classes,
               n.classes && grad.dynamics ? grad.dynamics + 3 * n.hidden : nullptr);
    }
}

template bool wide_forward<NT_REAL>(const Net<NT_REAL>&, const Layout&, const Outputs<NT_REAL>&, const Tape<NT_REAL>*);
template void wide_backward<NT_REAL>(const Net<NT_REAL>&, const Layout&, const Tape<NT_REAL>&, const Gradients<NT_REAL>&);

}  // namespace neurotact::NT_ISA
