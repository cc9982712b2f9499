// Networks and layers of any size. Forward: each trial by itself, event-driven, a panel of neurons in registers at a
// time. Backward: blocks of trials side by side, so that the one dense product of a step, dL/ds = dL/dI V^T, is a
// matrix product; weight gradients are gathered from the events of a few steps at once.
#include "parallel.h"

#include "dispatch.hpp"
#include "layer.hpp"

namespace neurotact::NT_ISA {
namespace {

constexpr int kBlock = 16;                          // trials side by side, backward
constexpr int kChunk = 16;                          // steps between two gatherings of weight gradients
constexpr int kTileRows = kVectorBytes == 64 ? 8 : 4;
constexpr int kTileVectors = kVectorBytes == 64 ? 3 : 2;

// ---- forward -------------------------------------------------------------------------------------------------------

// The moving state of one trial.
template <class T>
struct TrialState {
    T *current, *membrane, *readout_current, *readout_membrane;
    uint64_t *inputs, *decided;
    SpikeHistory spikes;
    uint32_t *rows, *counts, *readout_counts;
    int hidden_pitch, readout_pitch;

    TrialState(const Sizes& n, const Layout& layout, Carver& carver)
        : spikes(n.hidden, carver), hidden_pitch(layout.hidden_pitch), readout_pitch(layout.readout_pitch) {
        current = carver.take<T>(hidden_pitch);
        membrane = carver.take<T>(hidden_pitch);
        readout_current = carver.take<T>(readout_pitch);
        readout_membrane = carver.take<T>(readout_pitch);
        inputs = carver.take<uint64_t>(words(n.inputs));
        decided = carver.take<uint64_t>(words(n.classes) + 1);
        rows = carver.take<uint32_t>(n.inputs + n.hidden);
        counts = carver.take<uint32_t>(n.hidden);
        readout_counts = carver.take<uint32_t>(n.classes);
    }
    void reset(const Sizes& n) {
        std::memset(current, 0, hidden_pitch * sizeof(T));
        std::memset(membrane, 0, hidden_pitch * sizeof(T));
        std::memset(readout_current, 0, readout_pitch * sizeof(T));
        std::memset(readout_membrane, 0, readout_pitch * sizeof(T));
        spikes.clear(n.hidden);
        std::memset(decided, 0, (words(n.classes) + 1) * 8);
        std::memset(counts, 0, n.hidden * 4);
        std::memset(readout_counts, 0, n.classes * 4);
    }
};

NT_INLINE void count_bits(const uint64_t* bits, int64_t n_words, uint32_t* counts) {
    for (int64_t k = 0; k < n_words; k++)
        for (uint64_t m = bits[k]; m; m &= m - 1) counts[64 * k + lowest(m)]++;
}

template <class T, Membrane M, Reset R>
bool forward_trial(const Net<T>& net, const ForwardTables<T>& tables, TrialState<T>& s, int64_t trial,
                   const Outputs<T>& out, const Tape<T>* tape) {
    const Sizes& n = net.sizes;
    const int64_t in_words = words(n.inputs), hid_words = words(n.hidden);
    bool binary = true;
    s.reset(n);
    for (int64_t t = 0; t < n.steps; t++) {
        const int64_t row = trial * n.steps + t;
        binary &= pack_step(net.spikes, trial, t, n.inputs, s.inputs);
        int n_rows = list_rows(s.inputs, in_words, 0, s.rows, 0);
        if (net.w_rec)
            n_rows = list_rows(s.spikes.recurrent(net.recurrent_delay), hid_words, n.inputs, s.rows, n_rows);
        advance_layer<T, M, R>(tables.hidden, tables.table, s.rows, n_rows, s.current, s.membrane, s.spikes.next);
        const uint64_t* emitted = M == Membrane::immediate ? s.spikes.next : s.spikes.now;
        count_bits(emitted, hid_words, s.counts);
        if (out.raster) {
            T* line = out.raster + row * n.hidden;
            for (int i = 0; i < n.hidden; i++) line[i] = (T)(emitted[i / 64] >> (i % 64) & 1);
        }
        if (n.classes) {
            if (M != Membrane::immediate) count_bits(s.decided, words(n.classes), s.readout_counts);
            n_rows = list_rows(emitted, hid_words, 0, s.rows, 0);
            advance_layer<T, M, R>(tables.readout, tables.readout_table, s.rows, n_rows, s.readout_current,
                                   s.readout_membrane, s.decided);
            if (M == Membrane::immediate) count_bits(s.decided, words(n.classes), s.readout_counts);
        }
        if (tape) {
            std::memcpy(tape->membrane + row * s.hidden_pitch, s.membrane, s.hidden_pitch * sizeof(T));
            std::memcpy(tape->inputs + row * in_words, s.inputs, in_words * 8);
            std::memcpy(tape->spikes + row * hid_words, s.spikes.next, hid_words * 8);
            if (tape->current) std::memcpy(tape->current + row * s.hidden_pitch, s.current, s.hidden_pitch * sizeof(T));
            if (n.classes)
                std::memcpy(tape->readout_membrane + row * s.readout_pitch, s.readout_membrane,
                            s.readout_pitch * sizeof(T));
            if (n.classes && tape->current)
                std::memcpy(tape->readout_current + row * s.readout_pitch, s.readout_current,
                            s.readout_pitch * sizeof(T));
        }
        s.spikes.step();
    }
    if (out.hidden)
        for (int i = 0; i < n.hidden; i++) out.hidden[trial * n.hidden + i] = (T)s.counts[i];
    if (out.readout)
        for (int i = 0; i < n.classes; i++) out.readout[trial * n.classes + i] = (T)s.readout_counts[i];
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
    NT_INLINE void add(const uint64_t* events, int slot) {
        for (int64_t k = 0; k < words(neurons); k++)
            for (uint64_t m = events[k]; m; m &= m - 1) {
                const int64_t neuron = 64 * k + lowest(m);
                slots[neuron * kChunk * kBlock + counts[neuron]++] = (uint16_t)slot;
            }
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

// sums[j] += dL/dI of every slot at which neuron j had spiked
template <class T>
void gather(const EventLists& events, const T* history, int pitch, T* sums) {
    constexpr int L = kWide<T>;
    for (int j = 0; j < events.neurons; j++) {
        const int count = (int)events.counts[j];
        if (count == 0) continue;
        const uint16_t* slots = events.slots + (int64_t)j * kChunk * kBlock;
        T* sum = sums + (int64_t)j * pitch;
        int at = 0;
        for (; at + kPanel * L <= pitch; at += kPanel * L)
            gather_panel<T, kPanel>(slots, count, history + at, pitch, sum + at);
        for (; at + 2 * L <= pitch; at += 2 * L) gather_panel<T, 2>(slots, count, history + at, pitch, sum + at);
        for (; at < pitch; at += L) gather_panel<T, 1>(slots, count, history + at, pitch, sum + at);
    }
}

template <class T>
struct BackwardTables {
    LayerTables<T> hidden, readout;
    Panels<T> recurrent, out, in;

    BackwardTables(const Net<T>& net, const Layout& layout, bool with_inputs, Carver& carver) {
        const Sizes& n = net.sizes;
        hidden = pad_dynamics(net.hidden, n.hidden, layout.hidden_pitch, carver);
        readout = n.classes ? pad_dynamics(net.readout, n.classes, layout.readout_pitch, carver) : LayerTables<T>{};
        recurrent = net.w_rec ? Panels<T>::transposed(net.w_rec, n.hidden, n.hidden, carver) : Panels<T>{};
        out = n.classes ? Panels<T>::transposed(net.w_out, n.hidden, n.classes, carver) : Panels<T>{};
        in = with_inputs ? Panels<T>::transposed(net.w_in, n.inputs, n.hidden, carver) : Panels<T>{};
    }
};

// Sums over a group of trials; groups are added in their order, whatever thread did them.
template <class T>
struct Sums {
    T *w_in, *w_rec, *w_out;
    T *hidden_dynamics, *readout_dynamics;  // alpha, beta, threshold rows
    Sums(const Net<T>& net, const Layout& layout, Carver& carver) {
        const Sizes& n = net.sizes;
        w_in = carver.take<T>((int64_t)n.inputs * layout.hidden_pitch);
        w_rec = carver.take<T>(net.w_rec ? (int64_t)n.hidden * layout.hidden_pitch : 0);
        w_out = carver.take<T>((int64_t)n.hidden * layout.readout_pitch);
        hidden_dynamics = carver.take<T>(3 * layout.hidden_pitch);
        readout_dynamics = carver.take<T>(3 * layout.readout_pitch);
    }
};

// What a thread works with: one block of trials.
template <class T>
struct BlockState {
    T *current, *membrane, *emitted;                  // adjoints (trial, pitch): of I, of U and of s
    T *readout_current, *readout_membrane;
    T *history, *readout_history;                     // complete dL/dI[t+1], (slot, pitch)
    T *input_gradient, *class_gradient;
    uint64_t* silent;                                 // the spikes before the first step
    EventLists inputs, recurrent, sent;

    BlockState(const Net<T>& net, const Layout& layout, Carver& carver)
        : current(carver.take<T>(kBlock * layout.hidden_pitch)),
          membrane(carver.take<T>(kBlock * layout.hidden_pitch)),
          emitted(carver.take<T>(kBlock * layout.hidden_pitch)),
          readout_current(carver.take<T>(kBlock * layout.readout_pitch)),
          readout_membrane(carver.take<T>(kBlock * layout.readout_pitch)),
          history(carver.take<T>((int64_t)kChunk * kBlock * layout.hidden_pitch)),
          readout_history(carver.take<T>((int64_t)kChunk * kBlock * layout.readout_pitch)),
          input_gradient(carver.take<T>(kBlock * round_up(net.sizes.inputs, 16))),
          class_gradient(carver.take<T>(layout.readout_pitch)),
          silent(carver.take<uint64_t>(words(net.sizes.hidden))),
          inputs(net.sizes.inputs, carver),
          recurrent(net.w_rec ? net.sizes.hidden : 0, carver),
          sent(net.sizes.classes ? net.sizes.hidden : 0, carver) {}
};

// Step t of one layer of one trial, backwards; leaves dL/dI[t+1] in `complete`. `tape_*` point at row t of the trial.
template <class T, Membrane M, Reset R>
NT_INLINE void layer_back(const LayerTables<T>& layer, T scale, bool first, const T* tape_membrane,
                          const T* tape_current, const T* spike_gradient, T* adjoint_current, T* adjoint_membrane,
                          T* complete, T* sums) {
    using S = Simd<T, kWide<T>>;
    using V = typename S::V;
    const V wide_scale = all<S>(scale);
    for (int at = 0; at < layer.pitch; at += S::lanes) {
        const V threshold = load<S>(layer.threshold + at), after = load<S>(tape_membrane + at);
        const V before = first ? V{} : load<S>(tape_membrane - layer.pitch + at);
        const typename S::Mask fired = S::greater(before, threshold);
        Adjoint<S> adjoint{load<S>(adjoint_current + at), load<S>(adjoint_membrane + at)};
        const V sloped = surrogate_slope<S>(after, threshold, wide_scale) * load<S>(spike_gradient + at);
        V through;
        const V current =
            step_back<S, M, R>(adjoint, sloped, fired, load<S>(layer.alpha + at), load<S>(layer.beta + at), through);
        store(adjoint_current + at, adjoint.current);
        store(adjoint_membrane + at, adjoint.membrane);
        store(complete + at, current);
        if (sums) {
            T *alpha = sums + at, *beta = alpha + layer.pitch, *theta = beta + layer.pitch;
            const V current_before = first || !tape_current ? V{} : load<S>(tape_current - layer.pitch + at);
            V carried = R == Reset::hard ? S::clear(fired, before) : before;
            if (M == Membrane::eq4) carried = carried + current_before;
            store(alpha, load<S>(alpha) + current * current_before);
            store(beta, load<S>(beta) + through * carried);
            store(theta, load<S>(theta) - sloped);
        }
    }
}

template <class T, Membrane M, Reset R>
void backward_block(const Net<T>& net, const BackwardTables<T>& tables, const Tape<T>& tape, const Gradients<T>& grad,
                    BlockState<T>& s, Sums<T>& sums, int64_t first_trial, int trials) {
    const Sizes& n = net.sizes;
    const int pitch = tables.hidden.pitch, readout_pitch = tables.readout.pitch;
    const int64_t in_words = words(n.inputs), hid_words = words(n.hidden);
    const bool learned = grad.dynamics != nullptr;
    const auto clear = [](T* at, int64_t count) { std::memset(at, 0, count * sizeof(T)); };
    clear(s.current, (int64_t)trials * pitch);
    clear(s.membrane, (int64_t)trials * pitch);
    clear(s.emitted, (int64_t)trials * pitch);
    clear(s.readout_current, (int64_t)trials * readout_pitch);
    clear(s.readout_membrane, (int64_t)trials * readout_pitch);
    std::memset(s.silent, 0, hid_words * sizeof(uint64_t));
    // dL/ds through what the layer sends out at step t
    const auto add_emission = [&](int64_t t, const T* readout_history) {
        for (int m = 0; m < trials; m++) {
            const int64_t trial = first_trial + m;
            const T* from = grad.hidden ? grad.hidden + trial * n.hidden : nullptr;
            T* to = s.emitted + (int64_t)m * pitch;
            if (from)
                for (int i = 0; i < n.hidden; i++) to[i] += from[i];
            if (grad.raster)
                for (int i = 0; i < n.hidden; i++) to[i] += grad.raster[(trial * n.steps + t) * n.hidden + i];
        }
        if (n.classes) add_product(readout_history, readout_pitch, tables.out, s.emitted, trials);
    };
    int filled = 0;  // steps in the history
    const T* later = nullptr;  // the history of step t+1
    s.inputs.clear(), s.recurrent.clear(), s.sent.clear();
    for (int64_t t = n.steps - 1; t >= 0; t--) {
        T* history = s.history + (int64_t)filled * kBlock * pitch;
        T* readout_history = s.readout_history + (int64_t)filled * kBlock * readout_pitch;
        if (n.classes) {
            for (int m = 0; m < trials; m++) {
                const int64_t trial = first_trial + m, row = trial * n.steps + t;
                const bool heard = M == Membrane::immediate || t + 1 < n.steps;
                for (int c = 0; c < readout_pitch; c++)
                    s.class_gradient[c] = heard && grad.readout && c < n.classes ? grad.readout[trial * n.classes + c] : T(0);
                layer_back<T, M, R>(tables.readout, net.scale, t == 0, tape.readout_membrane + row * readout_pitch,
                                    tape.readout_current ? tape.readout_current + row * readout_pitch : nullptr,
                                    s.class_gradient, s.readout_current + (int64_t)m * readout_pitch,
                                    s.readout_membrane + (int64_t)m * readout_pitch,
                                    readout_history + (int64_t)m * readout_pitch,
                                    learned ? sums.readout_dynamics : nullptr);
            }
        }
        if (M == Membrane::immediate) add_emission(t, readout_history);
        for (int m = 0; m < trials; m++) {
            const int64_t trial = first_trial + m, row = trial * n.steps + t;
            const int64_t at = (int64_t)m * pitch;
            layer_back<T, M, R>(tables.hidden, net.scale, t == 0, tape.membrane + row * pitch,
                                tape.current ? tape.current + row * pitch : nullptr, s.emitted + at, s.current + at,
                                s.membrane + at, history + at, learned ? sums.hidden_dynamics : nullptr);
            const int slot = filled * kBlock + m;
            const auto spikes_of = [&](int64_t step) { // s[step]
                return step > 0 ? tape.spikes + (row - t + step - 1) * hid_words : s.silent;
            };
            const uint64_t* spikes = spikes_of(t);
            s.inputs.add(tape.inputs + row * in_words, slot);
            if (net.w_rec) s.recurrent.add(spikes_of(t - net.recurrent_delay), slot);
            if (n.classes) s.sent.add(M == Membrane::immediate ? tape.spikes + row * hid_words : spikes, slot);
        }
        clear(s.emitted, (int64_t)trials * pitch);
        // dL/ds[t] through what comes back to the layer: in I[t+1+d]
        const T* returning = net.recurrent_delay ? later : history;
        if (net.w_rec && returning) add_product(returning, pitch, tables.recurrent, s.emitted, trials);
        later = history;
        if (M != Membrane::immediate) add_emission(t, readout_history);
        if (grad.spikes) {
            clear(s.input_gradient, (int64_t)trials * tables.in.pitch);
            add_product(history, pitch, tables.in, s.input_gradient, trials);
            for (int m = 0; m < trials; m++)
                std::memcpy(grad.spikes + ((first_trial + m) * n.steps + t) * n.inputs,
                            s.input_gradient + (int64_t)m * tables.in.pitch, n.inputs * sizeof(T));
        }
        if (++filled == kChunk || t == 0) {
            gather(s.inputs, s.history, pitch, sums.w_in);
            if (net.w_rec) gather(s.recurrent, s.history, pitch, sums.w_rec);
            if (n.classes) gather(s.sent, s.readout_history, readout_pitch, sums.w_out);
            s.inputs.clear(), s.recurrent.clear(), s.sent.clear();
            filled = 0;
        }
    }
}

}  // namespace

template <class T>
bool wide_forward(const Net<T>& net, const Layout& layout, const Outputs<T>& out, const Tape<T>* tape) {
    Carver measure, thread_measure;
    ForwardTables<T>(net, layout, measure);
    TrialState<T>(net.sizes, layout, thread_measure);
    Block block(measure.bytes() + net.threads * thread_measure.bytes());
    Carver carver(block.data());
    const ForwardTables<T> tables(net, layout, carver);
    char* thread_memory = block.data() + measure.bytes();
    int others = 0;
#pragma omp parallel num_threads(net.threads) reduction(+ : others)
    {
        Carver mine(thread_memory + omp_get_thread_num() * thread_measure.bytes());
        TrialState<T> state(net.sizes, layout, mine);
        with_variant(net.membrane, net.reset, [&](auto M, auto R) {
#pragma omp for schedule(dynamic, 4)
            for (int64_t trial = 0; trial < net.sizes.trials; trial++)
                others += !forward_trial<T, M.value, R.value>(net, tables, state, trial, out, tape);
        });
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
        with_variant(net.membrane, net.reset, [&](auto M, auto R) {
#pragma omp for schedule(dynamic, 1)
            for (int group = 0; group < groups; group++) {
                Sums<T> sums = sums_of(group);
                std::memset(sums_memory + group * sums_measure.bytes(), 0, sums_measure.bytes());
                for (int64_t k = blocks * group / groups; k < blocks * (group + 1) / groups; k++) {
                    const int64_t first = k * kBlock, left = n.trials - first;
                    backward_block<T, M.value, R.value>(net, tables, tape, grad, state, sums, first,
                                                        left < kBlock ? (int)left : kBlock);
                }
            }
        });
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
