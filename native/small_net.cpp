// The fused network of up to 64 hidden and 32 readout neurons (64 beside 32 hidden; in float64 up to 32 and 16), the
// studies' own size: the state of two trials stays in registers over the whole window, spikes are one word a step, and sums cost what
// the spikes cost. Two trials at once hide each other's latencies and share every load of a weight in the dense product
// of the backward pass.
//
// A spike s[t] of the hidden layer goes into I[t+1+d] of that layer, d the recurrent delay, and into the readout: at
// step t under `eq4` and `delayed`, at step t-1 under `immediate`. So that one list of events serves both, the readout
// runs a step behind (`lag`) under `immediate`, and with a delay, which is not known here under `immediate`: turn t of
// the loop takes s[t-d] into step t of the hidden layer and into step t-lag of the readout.
//
// A feed-forward network has no row of V, and a layer without a readout (classes = 0) no row of W_out: both are zeros
// in the table of events, and left out where they would cost a product.
#include "parallel.h"

#include <tuple>
#include <type_traits>

#include "decide.hpp"
#include "dispatch.hpp"
#include "memory.hpp"
#include "spikes.hpp"
#include "step.hpp"

namespace neurotact::NT_ISA {
namespace {

constexpr int kPair = 2;    // trials side by side; an odd one runs beside a silent one
constexpr int kBlock = 8;   // trials whose gradients are summed in one go
constexpr int kRegisters = kVectorBytes == 64 ? 32 : 16;
constexpr int kProductVectors = 4;  // of the dense product's sums, in registers at once
constexpr int kAhead = 4;   // steps between asking for a row of the tape and using it
constexpr int kRows = 65;   // rows of a word's table: 64 neurons, then a row of zeros for "no more spikes"

// The trials of a pair, unrolled, so that the state of each finds its registers.
#define NT_EACH_TRIAL(s) _Pragma("GCC unroll 2") for (int s = 0; s < kPair; s++)

template <class T>
constexpr int kNarrow = kWide<T> < 8 ? kWide<T> : 8;

// Sizes and vectors of one instantiation: HP hidden and OP readout lanes.
template <class T, int HP, int OP>
struct Form {
    using SH = Simd<T, kWide<T>>;
    using SO = Simd<T, OP % kWide<T> ? kNarrow<T> : kWide<T>>;
    static constexpr int NH = HP / SH::lanes, NO = OP / SO::lanes;
    static constexpr int pitch = round_up(HP + OP, 64 / (int)sizeof(T));  // of an event's row
};

// The events of a step: the spikes that come in, then those of the hidden layer. One list, so that one loop takes
// them: how often it turns is what a processor cannot foresee, and a wrong guess costs as much as four events.
struct Events {
    int in_words, word, shift, n_words;

    explicit Events(const Sizes& n)
        : in_words((int)words(n.inputs)), word(n.inputs / 64), shift(n.inputs % 64),
          n_words((int)words(n.inputs + n.hidden)) {}
    NT_INLINE uint64_t operator()(int k, const uint64_t* inputs, uint64_t spikes) const {
        uint64_t events = k < in_words ? inputs[k] : 0;
        if (k == word) events |= spikes << shift;
        if (k == word + 1 && shift) events |= spikes >> (64 - shift);
        return events;
    }
};

NT_INLINE uint64_t any(const uint64_t (&events)[kPair]) { return events[0] | events[1]; }

template <class T>
struct Tables {
    const T* events;                               // forward: a row an event, (hidden lanes, readout lanes)
    const T *w_rec_transposed, *w_out_transposed;  // backward: a row a postsynaptic neuron, hidden lanes
};

// Lanes of a readout, and of the row of an event, as `with_form` chooses them.
constexpr int readout_lanes(const Layout& layout) { return layout.readout_pitch <= 8 ? 8 : layout.readout_pitch; }
template <class T>
int row_pitch(const Layout& layout) {
    return round_up(layout.hidden_pitch + readout_lanes(layout), 64 / (int)sizeof(T));
}
NT_INLINE int64_t event_row(int event) { return (int64_t)(event / 64) * kRows + event % 64; }

template <class T>
Tables<T> forward_tables(const Net<T>& net, const Layout& layout, Carver& carver) {
    const Sizes& n = net.sizes;
    const int hp = layout.hidden_pitch, pitch = row_pitch<T>(layout);
    const int64_t count = words(n.inputs + n.hidden) * kRows * pitch;
    T* table = carver.take<T>(count);
    if (table) {
        std::memset(table, 0, count * sizeof(T));
        for (int i = 0; i < n.inputs; i++)
            std::memcpy(table + event_row(i) * pitch, net.w_in + (int64_t)i * n.hidden, n.hidden * sizeof(T));
        for (int i = 0; i < n.hidden; i++) {
            T* row = table + event_row(n.inputs + i) * pitch;
            if (net.w_rec) std::memcpy(row, net.w_rec + (int64_t)i * n.hidden, n.hidden * sizeof(T));
            if (n.classes) std::memcpy(row + hp, net.w_out + (int64_t)i * n.classes, n.classes * sizeof(T));
        }
    }
    return {table, nullptr, nullptr};
}

template <class T>
const T* transposed(const T* from, int rows, int columns, int pitch, Carver& carver) {
    const int even = columns + columns % 2;  // the dense product takes two rows a turn
    T* to = carver.take<T>((int64_t)even * pitch);
    if (!to) return to;
    std::memset(to, 0, (int64_t)even * pitch * sizeof(T));
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c++) to[(int64_t)c * pitch + r] = from[(int64_t)r * columns + c];
    return to;
}

template <class T>
Tables<T> backward_tables(const Net<T>& net, const Layout& layout, Carver& carver) {
    const Sizes& n = net.sizes;
    const auto of = [&](const T* weights, int columns) {
        return weights ? transposed(weights, n.hidden, columns, layout.hidden_pitch, carver) : nullptr;
    };
    return {nullptr, of(net.w_rec, n.hidden), of(net.w_out, n.classes)};
}

// ---- forward -------------------------------------------------------------------------------------------------------

// One layer of one trial.
template <class S, int N>
struct Layer {
    Vectors<S, N> current{}, membrane{}, count{};
    typename S::Mask fired[N];  // U > threshold: whom the reset acts on
    uint64_t spikes = 0;
};

template <class S, int N>
NT_INLINE void fire(Layer<S, N>& layer, const Same<S>& threshold, uint64_t lanes) {
    uint64_t spikes = 0;
    for (int q = 0; q < N; q++) {
        layer.fired[q] = S::greater(layer.membrane[q], threshold.v);
        layer.count[q] += S::only(layer.fired[q], typename S::V{} + 1);
        spikes |= (uint64_t)S::bits(layer.fired[q]) << (q * S::lanes % 64);
    }
    layer.spikes = spikes & lanes;
}

template <class S, int N>
NT_INLINE void advance(Neuron neuron, Layer<S, N>& layer, const Vectors<S, N>& before, const Same<S>& beta,
                       const Same<S>& threshold, uint64_t lanes) {
    membrane_step(neuron, layer.membrane, before, layer.current, layer.fired, beta, threshold);
    fire(layer, threshold, lanes);
}

// U[t] and A[t] of a layer whose thresholds adapt; its registers hold U[t] - k A[t] as their membrane.
template <class T, int P>
struct Adapting {
    alignas(64) T membrane[P] = {}, adaptation[P] = {};
};

// The same of such a layer; `first`: at t = 0, where no neuron has spiked whatever its threshold.
template <class S, int N, class T, int P>
NT_INLINE void advance_adapting(Neuron neuron, const Adaptation<T>& how, Adapting<T, P>& state, Layer<S, N>& layer,
                                const Vectors<S, N>& before, const Same<S>& beta, const Same<S>& threshold,
                                uint64_t lanes, bool first) {
    auto adaptation = load_all<S, N>(state.adaptation);
    const auto crossed = raised(how, threshold, adaptation);
    if (!first) adaptation_step(how, adaptation, layer.fired);
    layer.membrane = load_all<S, N>(state.membrane);
    membrane_step(neuron, layer.membrane, before, layer.current, layer.fired, beta, crossed);
    store_all(state.adaptation, adaptation);
    store_all(state.membrane, layer.membrane);
    layer.membrane = lowered(how, layer.membrane, adaptation);
    fire(layer, threshold, lanes);
}

// Of a readout that leaks and does not spike, `membrane` is its value and `count` the step after which it was taken, the
// earliest of equal ones: the largest so far, else the last.
template <class S, int N, class T>
NT_INLINE void take(Layer<S, N>& layer, bool peak, T step) {
    for (int q = 0; q < N; q++) {
        const typename S::Mask more = S::greater(layer.current[q], layer.membrane[q]);
        const typename S::V now = all<S>(step);
        layer.membrane[q] = peak ? S::only(more, layer.current[q]) + S::clear(more, layer.membrane[q]) : layer.current[q];
        layer.count[q] = peak ? S::only(more, now) + S::clear(more, layer.count[q]) : now;
    }
}

// alpha, beta and threshold of the readout; one that leaks decays by `decay`.
template <class T>
Dynamics<T> readout_of(const Net<T>& net, const T* decay) {
    Dynamics<T> found = net.sizes.classes ? net.readout : net.hidden;
    if (net.integration.leaks) found.alpha = decay;
    return found;
}

NT_INLINE int64_t lag_of(const Neuron& neuron) { return neuron.emits_at_once() || neuron.recurrent_delay; }

template <class S, int N, class T>
NT_INLINE void write_counts(Layer<S, N>& layer, bool last_is_sent, int n, T* to) {
    if (to == nullptr) return;
    alignas(64) T counts[N * S::lanes];
    if (!last_is_sent)
        for (int q = 0; q < N; q++) layer.count[q] -= S::only(layer.fired[q], typename S::V{} + 1);
    store_all(counts, layer.count);
    std::memcpy(to, counts, n * sizeof(T));
}

// Counts of a stretch that ends here; from now on the layer counts for the next one.
template <class S, int N, class T>
NT_INLINE void next_stretch(Layer<S, N>& layer, bool last_is_sent, int n, T* to) {
    write_counts(layer, last_is_sent, n, to);
    for (int q = 0; q < N; q++)
        layer.count[q] = last_is_sent ? typename S::V{} : S::only(layer.fired[q], typename S::V{} + 1);
}

template <class T, int HP, int OP, bool Adapts>
void forward_trials(const Net<T>& net, const Tables<T>& tables, int64_t first, const uint64_t* inputs,
                    const Outputs<T>& out, const Tape<T>* tape) {
    using F = Form<T, HP, OP>;
    using SH = typename F::SH;
    using SO = typename F::SO;
    constexpr int NH = F::NH, NO = F::NO, N = kPair;
    const Sizes& n = net.sizes;
    const Neuron neuron = net.neuron;
    const auto alpha = all<SH>(net.hidden.alpha[0]);
    const Same<SH> beta{all<SH>(net.hidden.beta[0])}, threshold{all<SH>(net.hidden.threshold[0])};
    const bool reads_out = n.classes > 0, delayed = neuron.recurrent_delay > 0;
    const bool leaks = net.integration.leaks, peak = net.integration.peak;
    const T decay = (T)net.integration.decay;
    const Dynamics<T> dynamics_out = readout_of(net, &decay);
    const auto alpha_out = all<SO>(dynamics_out.alpha[0]);
    const Same<SO> beta_out{all<SO>(dynamics_out.beta[0])}, threshold_out{all<SO>(dynamics_out.threshold[0])};
    const uint64_t hidden_lanes = n.hidden == 64 ? ~0ull : (1ull << n.hidden) - 1;
    const Events list(n);
    const int64_t steps = n.steps, lag = lag_of(neuron);
    uint64_t spikes_before[N] = {};  // s[t-1], for turn t of a network with a delay
    Layer<SH, NH> hidden[N];
    Layer<SO, NO> readout[N];
    [[maybe_unused]] Adapting<T, Adapts ? HP : 1> adapting[N];
    for (int s = 0; s < N; s++) {
        for (auto& fired : hidden[s].fired) fired = SH::greater(typename SH::V{}, threshold.v);
        for (auto& fired : readout[s].fired) fired = SO::greater(typename SO::V{}, threshold_out.v);
    }
    const auto row_of = [&](T* part, int pitch) { return tape && part ? part + first * steps * pitch : nullptr; };
    T* membrane = row_of(tape ? tape->membrane : nullptr, HP);
    T* current = row_of(tape ? tape->current : nullptr, HP);
    [[maybe_unused]] T* raised = row_of(tape ? tape->raised : nullptr, HP);
    T* readout_membrane = row_of(tape && reads_out ? tape->readout_membrane : nullptr, OP);
    T* readout_current = row_of(tape && reads_out ? tape->readout_current : nullptr, OP);
    uint64_t* spikes = tape ? tape->spikes + first * steps : nullptr;
    const auto write_readout = [&](int s, int64_t step) __attribute__((always_inline)) {
        if (readout_membrane) store_all(readout_membrane + (s * steps + step) * OP, readout[s].membrane);
        if (readout_current) store_all(readout_current + (s * steps + step) * OP, readout[s].current);
    };
    const auto counts_of = [&](int s, int64_t step) {
        const int64_t row = (first + s) * net.integration.stretches + net.integration.stretch_of(step);
        return out.hidden ? out.hidden + row * n.hidden : nullptr;
    };
    for (int64_t t = 0; t < steps; t++) {
        Vectors<SH, NH> before[N];
        Vectors<SO, NO> before_out[N];
        NT_EACH_TRIAL(s) {
            before[s] = hidden[s].current;
            before_out[s] = readout[s].current;
            for (int q = 0; q < NH; q++) hidden[s].current[q] = alpha * before[s][q];
            for (int q = 0; q < NO; q++) readout[s].current[q] = alpha_out * before_out[s][q];
        }
        for (int k = 0; k < list.n_words; k++) {
            uint64_t events[N];
            NT_EACH_TRIAL(s)
                events[s] = list(k, inputs + (s * steps + t) * list.in_words,
                                 delayed ? spikes_before[s] : hidden[s].spikes);
            const T* table = tables.events + k * kRows * F::pitch;
            while (any(events))
                NT_EACH_TRIAL(s) {
                    const T* row = table + lowest(events[s]) * F::pitch;
                    events[s] &= events[s] - 1;
                    for (int q = 0; q < NH; q++) hidden[s].current[q] += load<SH>(row + q * SH::lanes);
                    for (int q = 0; q < NO; q++) readout[s].current[q] += load<SO>(row + HP + q * SO::lanes);
                }
        }
        NT_EACH_TRIAL(s) {
            spikes_before[s] = hidden[s].spikes;
            if constexpr (Adapts)
                advance_adapting(neuron, net.adaptation, adapting[s], hidden[s], before[s], beta, threshold, hidden_lanes,
                                 t == 0);
            else
                advance(neuron, hidden[s], before[s], beta, threshold, hidden_lanes);
            if (leaks) {
                if (t >= lag) take(readout[s], peak, (T)(t - lag + 1));
            } else if (reads_out && t >= lag) {
                advance(neuron, readout[s], before_out[s], beta_out, threshold_out, ~0ull);
                write_readout(s, t - lag);
            }
            if (out.spikes) out.spikes[s * steps + t] = hidden[s].spikes;
            if (membrane) {
                fetch<true>(membrane + (s * steps + t + kAhead) * HP, HP);
                store_all(membrane + (s * steps + t) * HP, hidden[s].membrane);
                spikes[s * steps + t] = hidden[s].spikes;
                if (current) store_all(current + (s * steps + t) * HP, hidden[s].current);
                if constexpr (Adapts)
                    for (int i = 0; raised && i < HP; i++)
                        raised[(s * steps + t) * HP + i] = net.adaptation.strength * adapting[s].adaptation[i];
            }
        }
        if (net.integration.ends(t) && t < steps - 1)
            for (int s = 0; s < N && first + s < n.trials; s++)
                next_stretch(hidden[s], neuron.emits_at_once(), n.hidden, counts_of(s, t));
    }
    if (reads_out && lag && steps)
        for (int s = 0; s < N; s++) {
            const uint64_t sent = delayed ? spikes_before[s] : hidden[s].spikes;
            const Vectors<SO, NO> before_out = readout[s].current;
            for (int q = 0; q < NO; q++) readout[s].current[q] = alpha_out * before_out[q];
            for (int i = 0; i < n.hidden; i++)
                if (sent >> i & 1)
                    for (int q = 0; q < NO; q++)
                        readout[s].current[q] +=
                            load<SO>(tables.events + event_row(n.inputs + i) * F::pitch + HP + q * SO::lanes);
            if (leaks) {
                take(readout[s], peak, (T)steps);
                continue;
            }
            advance(neuron, readout[s], before_out, beta_out, threshold_out, ~0ull);
            write_readout(s, steps - 1);
        }
    if (leaks && tape)
        for (int s = 0; s < N; s++) store_all(tape->taken + (first + s) * OP, readout[s].count);
    const bool last_is_sent = neuron.emits_at_once() || steps == 0;
    for (int s = 0; s < N && first + s < n.trials; s++) {
        write_counts(hidden[s], last_is_sent, n.hidden, counts_of(s, steps ? steps - 1 : 0));
        if (leaks) readout[s].count = readout[s].membrane;
        if (out.readout) write_counts(readout[s], last_is_sent || leaks, n.classes, out.readout + (first + s) * n.classes);
    }
}

// ---- backward ------------------------------------------------------------------------------------------------------

// Sums over a group of trials.
template <class T>
struct Sums {
    T* events;                               // as Tables::events
    T *hidden_dynamics, *readout_dynamics;   // rows of alpha, beta and threshold; null where none are learned

    Sums(const Sizes& n, const Layout& layout, bool learned, Carver& carver)
        : events(carver.take<T>(words(n.inputs + n.hidden) * kRows * row_pitch<T>(layout))),
          hidden_dynamics(learned ? carver.take<T>(3 * layout.hidden_pitch) : nullptr),
          readout_dynamics(learned ? carver.take<T>(3 * readout_lanes(layout)) : nullptr) {}
};

template <class S, class T>
NT_INLINE void add_at(T* at, typename S::V what) {
    store(at, load<S>(at) + what);
}

// One layer of one trial, backwards.
template <class S, int N>
struct LayerBack {
    Adjoint<S, N> adjoint;
    Vectors<S, N> after;  // U[t+1]
};

// What all trials of a layer share.
template <class S>
struct Constants {
    Same<S> alpha, beta, threshold;
    typename S::V scale;

    template <class T>
    explicit Constants(const Dynamics<T>& from)
        : alpha{all<S>(from.alpha[0])}, beta{all<S>(from.beta[0])}, threshold{all<S>(from.threshold[0])},
          scale(all<S>(from.scale)) {}
};

// Step t of a layer backwards; `before` is U[t]. Returns dL/dI[t+1]. Where dynamics are learned, `sums` has a row of
// `pitch` neurons each for alpha, beta and threshold, and `current_before` points at I[t] (null at the first step).
template <class S, int N, class T>
NT_INLINE Vectors<S, N> layer_back(Neuron neuron, const Constants<S>& constants, LayerBack<S, N>& layer,
                                   const Vectors<S, N>& before, const Vectors<S, N>& spike_gradient,
                                   const T* current_before, T* sums, int pitch) {
    Vectors<S, N> sloped;
    typename S::Mask fired[N];
    for (int q = 0; q < N; q++) {
        sloped[q] = surrogate_slope<S>(layer.after[q], constants.threshold.v, constants.scale) * spike_gradient[q];
        fired[q] = S::greater(before[q], constants.threshold.v);
    }
    const auto gradient = step_back(neuron, layer.adjoint, sloped, fired, constants.alpha, constants.beta);
    if (sums) {
        const auto current = current_before ? load_all<S, N>(current_before) : Vectors<S, N>{};
        add_dynamics(neuron, gradient, sloped, before, current, fired, sums, pitch);
    }
    layer.after = before;
    return gradient.current;
}

// The same where thresholds adapt: `before` is U[t] - k A[t], `adjoint` dL/dA[t+2], which becomes dL/dA[t+1], and
// `raised_before` points at k A[t] (null at the first step, and where no dynamics are learned).
template <class S, int N, class T>
NT_INLINE Vectors<S, N> adapting_layer_back(Neuron neuron, const Adaptation<T>& how, T* adjoint,
                                            const Constants<S>& constants, LayerBack<S, N>& layer,
                                            const Vectors<S, N>& before, const Vectors<S, N>& spike_gradient,
                                            const T* current_before, const T* raised_before, T* sums, int pitch) {
    auto adaptation = load_all<S, N>(adjoint);
    Vectors<S, N> sloped;
    typename S::Mask fired[N];
    for (int q = 0; q < N; q++) {
        sloped[q] = surrogate_slope<S>(layer.after[q], constants.threshold.v, constants.scale) *
                    (spike_gradient[q] + adaptation[q]);
        fired[q] = S::greater(before[q], constants.threshold.v);
    }
    adaptation_back(how, adaptation, sloped);
    store_all(adjoint, adaptation);
    const auto gradient = step_back(neuron, layer.adjoint, sloped, fired, constants.alpha, constants.beta);
    if (sums) {
        const auto current = current_before ? load_all<S, N>(current_before) : Vectors<S, N>{};
        auto membrane = before;
        for (int q = 0; raised_before && q < N; q++)
            membrane[q] = before[q] + load<S>(raised_before + q * S::lanes);
        add_dynamics(neuron, gradient, sloped, membrane, current, fired, sums, pitch);
    }
    layer.after = before;
    return gradient.current;
}

// The same of a readout that leaks: a value that was taken after step t, as `after` says, hands its gradient to y[t+1].
template <class S, int N, class T>
NT_INLINE Vectors<S, N> leak_back(const Constants<S>& constants, LayerBack<S, N>& layer,
                                  const Vectors<S, N>& value_gradient, T step) {
    Vectors<S, N> complete;
    const typename S::V now = all<S>(step);
    for (int q = 0; q < N; q++) {
        const auto not_later = S::clear(S::greater(layer.after[q], now), value_gradient[q]);
        complete[q] = layer.adjoint.current[q] + S::clear(S::greater(now, layer.after[q]), not_later);
        layer.adjoint.current[q] = constants.alpha.v * complete[q];
    }
    return complete;
}

// sum[s] += g[s] matrix for every trial s, in the vectors At to At + W: `matrix` has a row of N vectors for each neuron
// i of g, an even number of rows. Even and odd rows are summed apart, so that more additions are under way at a time:
// side by side where the registers hold both sums, else one after the other.
template <int At, int W, class S, int N, int P, class T>
NT_INLINE void add_product_panel(Vectors<S, N> (&sum)[P], const T* g, int g_pitch, const T* matrix, int rows) {
    constexpr int pitch = N * S::lanes;
    matrix += At * S::lanes;
    Vectors<S, W> even[P], odd[P]{};
    for (int s = 0; s < P; s++)
        for (int q = 0; q < W; q++) even[s][q] = sum[s][At + q];
    const auto add_row = [&](Vectors<S, W>(&to)[P], int i) __attribute__((always_inline)) {
        const auto w = load_all<S, W>(matrix + i * pitch);
        for (int s = 0; s < P; s++) {
            const auto factor = all<S>(g[s * g_pitch + i]);
            for (int q = 0; q < W; q++) to[s][q] += factor * w[q];
        }
    };
    if constexpr (2 * P * W <= kRegisters / 2) {
        for (int i = 0; i < rows; i += 2) add_row(even, i), add_row(odd, i + 1);
    } else {
        for (int i = 0; i < rows; i += 2) add_row(even, i);
        for (int i = 1; i < rows; i += 2) add_row(odd, i);
    }
    for (int s = 0; s < P; s++)
        for (int q = 0; q < W; q++) sum[s][At + q] = even[s][q] + odd[s][q];
}

template <class S, int N, int P, class T, int At = 0>
NT_INLINE void add_product(Vectors<S, N> (&sum)[P], const T* g, int g_pitch, const T* matrix, int rows) {
    constexpr int W = N - At < kProductVectors ? N - At : kProductVectors;
    add_product_panel<At, W>(sum, g, g_pitch, matrix, rows);
    if constexpr (At + W < N) add_product<S, N, P, T, At + W>(sum, g, g_pitch, matrix, rows);
}

template <class T, int HP, int OP, bool Adapts>
void backward_trials(const Net<T>& net, const Tables<T>& tables, const Tape<T>& tape, const Gradients<T>& grad,
                     const Sums<T>& sums, int64_t first) {
    using F = Form<T, HP, OP>;
    using SH = typename F::SH;
    using SO = typename F::SO;
    constexpr int NH = F::NH, NO = F::NO, N = kPair;
    const Sizes& n = net.sizes;
    const Neuron neuron = net.neuron;
    const bool reads_out = n.classes > 0, delayed = neuron.recurrent_delay > 0, recurs = net.w_rec != nullptr;
    const Constants<SH> constants(net.hidden);
    const bool leaks = net.integration.leaks;
    const T decay = (T)net.integration.decay;
    const Constants<SO> constants_out(readout_of(net, &decay));
    const Events list(n);
    const int64_t steps = n.steps, lag = lag_of(neuron);
    if (steps == 0) return;
    const T* membrane = tape.membrane + first * steps * HP;
    const T* readout_membrane = tape.readout_membrane + first * steps * OP;
    const T* current = tape.current ? tape.current + first * steps * HP : nullptr;
    [[maybe_unused]] const T* raised = tape.raised ? tape.raised + first * steps * HP : nullptr;
    const T* readout_current = tape.readout_current ? tape.readout_current + first * steps * OP : nullptr;
    const uint64_t* inputs = tape.inputs + first * steps * list.in_words;
    const uint64_t* spikes = tape.spikes + first * steps;

    alignas(64) T count_gradient[N][HP] = {}, class_gradient[N][OP] = {};
    alignas(64) T g[N][HP], g_out[N][OP], waiting[N][HP] = {};  // waiting: with a delay, dL/ds[t] in turn t
    [[maybe_unused]] alignas(64) T adaptation_adjoint[N][Adapts ? HP : 1] = {};  // dL/dA[t+2] in turn t
    LayerBack<SH, NH> hidden[N];
    LayerBack<SO, NO> readout[N];
    Vectors<SH, NH> spike_gradient[N];  // dL/ds[t+1] in turn t
    const int64_t last = steps - 1;
    for (int s = 0; s < N; s++) {
        const int64_t trial = first + s;
        const bool real = trial < n.trials;
        if (grad.readout && real) std::memcpy(class_gradient[s], grad.readout + trial * n.classes, n.classes * sizeof(T));
        hidden[s].after = load_all<SH, NH>(membrane + (s * steps + last) * HP);
        if (leaks) readout[s].after = load_all<SO, NO>(tape.taken + trial * OP);
        else if (reads_out) readout[s].after = load_all<SO, NO>(readout_membrane + (s * steps + last) * OP);
        spike_gradient[s] = Vectors<SH, NH>{};
    }
    int64_t stretch = -1;
    // The gradient of the counts in which the spikes of this step are.
    const auto count_at = [&](int64_t step) __attribute__((always_inline)) {
        const int64_t now = net.integration.stretch_of(step < 0 ? 0 : step);
        if (now == stretch || !grad.hidden) return;
        stretch = now;
        for (int s = 0; s < N && first + s < n.trials; s++)
            std::memcpy(count_gradient[s], grad.hidden + ((first + s) * net.integration.stretches + now) * n.hidden,
                        n.hidden * sizeof(T));
    };
    const int out_rows = n.classes + n.classes % 2, hidden_rows = n.hidden + n.hidden % 2;
    Vectors<SO, NO> complete_out[N]{};
    const auto readout_back = [&](int s, int64_t step) __attribute__((always_inline)) {
        if (leaks) {
            complete_out[s] = leak_back(constants_out, readout[s], load_all<SO, NO>(class_gradient[s]), (T)(step + 1));
            store_all(g_out[s], complete_out[s]);
            return;
        }
        const int64_t at = (s * steps + step) * OP;
        const Vectors<SO, NO> before = step ? load_all<SO, NO>(readout_membrane + at - OP) : Vectors<SO, NO>{};
        Vectors<SO, NO> decided{};  // s[T] is sent only where step T-1 emits it
        if (neuron.emits_at_once() || step < last) decided = load_all<SO, NO>(class_gradient[s]);
        const T* current_before = readout_current && step ? readout_current + at - OP : nullptr;
        complete_out[s] = layer_back(neuron, constants_out, readout[s], before, decided, current_before,
                                     sums.readout_dynamics, OP);
        store_all(g_out[s], complete_out[s]);
    };
    const auto spikes_at = [&](int s, int64_t step) __attribute__((always_inline)) {
        return step > 0 ? spikes[s * steps + step - 1] : 0;
    };
    // dL/ds[t-d], from where turn t took it: into the readout at `step` and, but for the turn after the last step, into
    // the hidden layer.
    const auto gather_spike_gradient = [&](int64_t step, bool into_hidden) __attribute__((always_inline)) {
        count_at(step);
        Vectors<SH, NH> gathered[N];
        NT_EACH_TRIAL(s) gathered[s] = load_all<SH, NH>(count_gradient[s]);
        if (reads_out) add_product(gathered, g_out[0], OP, tables.w_out_transposed, out_rows);
        if (into_hidden) add_product(gathered, g[0], HP, tables.w_rec_transposed, hidden_rows);
        NT_EACH_TRIAL(s) {
            spike_gradient[s] = delayed ? load_all<SH, NH>(waiting[s]) : gathered[s];
            if (delayed) store_all(waiting[s], gathered[s]);
        }
    };
    if (lag) {
        for (int s = 0; s < N && reads_out; s++) {
            readout_back(s, last);
            for (int i = 0; i < n.hidden; i++)
                if (spikes_at(s, steps - neuron.recurrent_delay) >> i & 1)
                    for (int q = 0; q < NO; q++)
                        add_at<SO>(sums.events + event_row(n.inputs + i) * F::pitch + HP + q * SO::lanes,
                                   complete_out[s][q]);
        }
        gather_spike_gradient(last, false);
    }
    for (int64_t t = last; t >= 0; t--) {
        Vectors<SH, NH> complete[N];
        NT_EACH_TRIAL(s) {
            if (reads_out && t >= lag) readout_back(s, t - lag);
            const int64_t at = (s * steps + t) * HP;
            fetch(membrane + at - kAhead * HP, HP);
            const Vectors<SH, NH> before = t ? load_all<SH, NH>(membrane + at - HP) : Vectors<SH, NH>{};
            if constexpr (Adapts)
                complete[s] = adapting_layer_back(neuron, net.adaptation, adaptation_adjoint[s], constants, hidden[s],
                                                  before, spike_gradient[s], current && t ? current + at - HP : nullptr,
                                                  raised && t ? raised + at - HP : nullptr, sums.hidden_dynamics, HP);
            else
                complete[s] = layer_back(neuron, constants, hidden[s], before, spike_gradient[s],
                                         current && t ? current + at - HP : nullptr, sums.hidden_dynamics, HP);
            store_all(g[s], complete[s]);
        }
        // dL/dw of every event: dL/dI of the layer it went into.
        for (int k = 0; k < list.n_words; k++) {
            uint64_t events[N];
            NT_EACH_TRIAL(s)
                events[s] = list(k, inputs + (s * steps + t) * list.in_words, spikes_at(s, t - neuron.recurrent_delay));
            T* table = sums.events + k * kRows * F::pitch;
            while (any(events))
                NT_EACH_TRIAL(s) {
                    T* row = table + lowest(events[s]) * F::pitch;
                    events[s] &= events[s] - 1;
                    for (int q = 0; q < NH; q++) add_at<SH>(row + q * SH::lanes, complete[s][q]);
                    for (int q = 0; q < NO; q++) add_at<SO>(row + HP + q * SO::lanes, complete_out[s][q]);
                }
        }
        gather_spike_gradient(t - lag, recurs);
    }
}

// ---- sizes ---------------------------------------------------------------------------------------------------------

// Calls `run_form` with the lanes of both layers, and whether thresholds adapt, as compile-time constants: the forms that
// `layout_of` hands out. Compiled apart, adaptation leaves the loops of other networks as they are.
template <class T, class Run>
NT_INLINE void with_form(const Layout& layout, bool adapts, const Run& run_form) {
    constexpr bool all_forms = sizeof(T) == sizeof(float);
    const auto with_readout = [&](auto HP) __attribute__((always_inline)) {
        const auto run = [&](auto OP) __attribute__((always_inline)) {
            constexpr bool rare = all_forms && HP.value % kRarePitch == 0, adapting = rare && OP.value <= kAdaptingReadout;
            if constexpr (adapting)
                if (adapts) return run_form(HP, OP, std::true_type());
            if constexpr (OP.value <= 16 || rare) run_form(HP, OP, std::false_type());
        };
        const int lanes = readout_lanes(layout);
        if (lanes == 8) return run(std::integral_constant<int, 8>());
        if (lanes == 16) return run(std::integral_constant<int, 16>());
        if (lanes == 32) return run(std::integral_constant<int, 32>());
        if constexpr (HP.value <= 32) run(std::integral_constant<int, 64>());
    };
    if (layout.hidden_pitch == 16) return with_readout(std::integral_constant<int, 16>());
    if (layout.hidden_pitch == 32) return with_readout(std::integral_constant<int, 32>());
    if constexpr (all_forms) {
        if (layout.hidden_pitch == 48) return with_readout(std::integral_constant<int, 48>());
        with_readout(std::integral_constant<int, 64>());
    }
}

}  // namespace

// The input spikes of a pair; how many of its trials have other values than 0 and 1.
template <class T>
int pack_pair(const Net<T>& net, int64_t first, uint64_t* to) {
    const Sizes& n = net.sizes;
    const int64_t trial_words = n.steps * words(n.inputs);
    int others = 0;
    for (int s = 0; s < kPair; s++, to += trial_words) {
        if (first + s < n.trials) others += !pack_trial(net.spikes, first + s, n.steps, n.inputs, to);
        else std::memset(to, 0, trial_words * sizeof(uint64_t));
    }
    return others;
}

template <class T>
bool small_forward(const Net<T>& net, const Layout& layout, const Outputs<T>& out, const Tape<T>* tape) {
    const Sizes& n = net.sizes;
    const int64_t trial_words = n.steps * words(n.inputs), pairs = (n.trials + kPair - 1) / kPair;
    Carver measure;
    forward_tables(net, layout, measure);
    Block block(measure.bytes() + (tape ? 0 : net.threads * kPair * trial_words * sizeof(uint64_t)));
    Carver carver(block.data());
    const Tables<T> tables = forward_tables(net, layout, carver);
    int others = 0;
#pragma omp parallel num_threads(net.threads) reduction(+ : others)
    {
        uint64_t* mine = (uint64_t*)(block.data() + measure.bytes()) + omp_get_thread_num() * kPair * trial_words;
        with_form<T>(layout, net.adaptation.on, [&](auto HP, auto OP, auto Adapts) {
#pragma omp for schedule(dynamic, 4)
            for (int64_t pair = 0; pair < pairs; pair++) {
                const int64_t first = pair * kPair;
                uint64_t* inputs = tape ? tape->inputs + first * trial_words : mine;
                others += pack_pair(net, first, inputs);
                forward_trials<T, HP.value, OP.value, Adapts.value>(net, tables, first, inputs, out, tape);
            }
        });
    }
    return others == 0;
}

// What an integrator makes of a whole window, from the hidden layer's spikes s[t+1], as infer.cpp does step by step.
template <class T>
void integrate(const Net<T>& net, const uint64_t* inputs, const uint64_t* spikes, uint32_t* rows,
               IntegratingReadout<T>& readout, double* sums) {
    const Sizes& n = net.sizes;
    readout.start(sums);
    for (int64_t t = 0; t < n.steps; t++) {
        const uint64_t sent = net.neuron.emits_at_once() ? spikes[t] : t ? spikes[t - 1] : 0;
        int n_rows = 0;
        if (net.integration.direct) n_rows = list_rows(inputs + t * words(n.inputs), words(n.inputs), n.hidden, rows, 0);
        readout.step(rows, list_rows(&sent, 1, 0, rows, n_rows), t, sums);
    }
}

NT_INLINE int64_t count_spikes(const uint64_t* spikes, int64_t n_words) {
    int64_t found = 0;
    for (int64_t k = 0; k < n_words; k++) found += __builtin_popcountll(spikes[k]);
    return found;
}

// Inference without early exit. An integrator adds in float64: beside it, this kernel computes the hidden layer alone.
template <class T>
bool small_infer(const Net<T>& net, const Layout& of_net, const Decisions& to) {
    Net<T> run = net;
    Layout layout = of_net;
    if (net.bias) {
        run.sizes.classes = 0;
        run.integration = {};
        layout = layout_of(run.sizes, net.neuron, sizeof(T) == sizeof(double), net.adaptation.on, false);
    }
    const Sizes& n = net.sizes;
    const int64_t trial_words = n.steps * words(n.inputs), pairs = (n.trials + kPair - 1) / kPair;
    Carver measure, of_thread, nothing;
    const ForwardTables<T> none(net, nothing);
    forward_tables(run, layout, measure);
    measure.take<T>(n.trials * n.classes);
    const auto cut = [&](Carver& carver) {
        uint64_t* inputs = carver.take<uint64_t>(kPair * trial_words);
        uint64_t* spikes = carver.take<uint64_t>(kPair * n.steps);
        return std::make_tuple(inputs, spikes, carve_rows(n.inputs + n.hidden, carver));
    };
    cut(of_thread);
    IntegratingReadout<T>(net, none, of_thread);
    Block block(measure.bytes() + net.threads * of_thread.bytes());
    Carver carver(block.data());
    const Tables<T> tables = forward_tables(run, layout, carver);
    T* counts = carver.take<T>(n.trials * n.classes);
    int others = 0;
#pragma omp parallel num_threads(net.threads) reduction(+ : others)
    {
        Carver mine(block.data() + measure.bytes() + omp_get_thread_num() * of_thread.bytes());
        const auto [inputs, spikes, rows] = cut(mine);
        IntegratingReadout<T> integrator(net, none, mine);
        const Outputs<T> out{net.bias ? nullptr : counts, nullptr, nullptr, spikes};
        with_form<T>(layout, net.adaptation.on, [&, inputs = inputs, spikes = spikes, rows = rows](auto HP, auto OP, auto Adapts) {
#pragma omp for schedule(dynamic, 4)
            for (int64_t pair = 0; pair < pairs; pair++) {
                const int64_t first = pair * kPair;
                others += pack_pair(net, first, inputs);
                forward_trials<T, HP.value, OP.value, Adapts.value>(run, tables, first, inputs, out, nullptr);
                for (int s = 0; s < kPair && first + s < n.trials; s++) {
                    const int64_t trial = first + s, heard = n.steps - (n.steps && !net.neuron.emits_at_once());
                    to.steps[trial] = n.steps;
                    to.input_spikes[trial] = count_spikes(inputs + s * trial_words, trial_words);
                    to.hidden_spikes[trial] = count_spikes(spikes + s * n.steps, heard);
                    if (net.bias) {
                        double* sums = to.sums + trial * n.classes;
                        integrate(net, inputs + s * trial_words, spikes + s * n.steps, rows, integrator, sums);
                        to.labels[trial] = Leader<double>{sums, n.classes}.leading();
                    } else {
                        int64_t* found = to.counts + trial * n.classes;
                        for (int c = 0; c < n.classes; c++) found[c] = (int64_t)counts[trial * n.classes + c];
                        to.labels[trial] = Leader<int64_t>{found, n.classes}.leading();
                    }
                }
            }
        });
    }
    return others == 0;
}

template <class T>
void small_backward(const Net<T>& net, const Layout& layout, const Tape<T>& tape, const Gradients<T>& grad) {
    const Sizes& n = net.sizes;
    const int64_t blocks = (n.trials + kBlock - 1) / kBlock;
    const int groups = (int)(blocks < kSmallGroups ? blocks : kSmallGroups);
    const bool learned = grad.dynamics != nullptr;
    Carver measure, sums_measure;
    backward_tables(net, layout, measure);
    Sums<T>(n, layout, learned, sums_measure);
    Block block(measure.bytes() + groups * sums_measure.bytes());
    Carver carver(block.data());
    const Tables<T> tables = backward_tables(net, layout, carver);
    char* sums_memory = block.data() + measure.bytes();
    const auto sums_of = [&](int group) {
        Carver at(sums_memory + group * sums_measure.bytes());
        return Sums<T>(n, layout, learned, at);
    };
#pragma omp parallel num_threads(net.threads)
    with_form<T>(layout, net.adaptation.on, [&](auto HP, auto OP, auto Adapts) {
#pragma omp for schedule(dynamic, 1)
        for (int group = 0; group < groups; group++) {
            const Sums<T> sums = sums_of(group);
            std::memset(sums_memory + group * sums_measure.bytes(), 0, sums_measure.bytes());
            const int64_t end = blocks * (group + 1) / groups * kBlock;
            for (int64_t first = blocks * group / groups * kBlock; first < end && first < n.trials; first += kPair)
                backward_trials<T, HP.value, OP.value, Adapts.value>(net, tables, tape, grad, sums, first);
        }
    });
    // Group after group, whatever thread did them.
    const auto add_up = [&](T* Sums<T>::*part, int64_t offset, int columns, T* to) {
        for (int c = 0; c < columns; c++) to[c] = 0;
        for (int group = 0; group < groups; group++) {
            const T* from = sums_of(group).*part + offset;
            for (int c = 0; c < columns; c++) to[c] += from[c];
        }
    };
    const int pitch = row_pitch<T>(layout), hp = layout.hidden_pitch, op = readout_lanes(layout);
    for (int i = 0; i < n.inputs; i++)
        add_up(&Sums<T>::events, event_row(i) * pitch, n.hidden, grad.w_in + (int64_t)i * n.hidden);
    for (int i = 0; i < n.hidden; i++) {
        const int64_t row = event_row(n.inputs + i) * pitch;
        if (net.w_rec) add_up(&Sums<T>::events, row, n.hidden, grad.w_rec + (int64_t)i * n.hidden);
        if (n.classes) add_up(&Sums<T>::events, row + hp, n.classes, grad.w_out + (int64_t)i * n.classes);
    }
    for (int r = 0; r < 3 && learned; r++) {
        add_up(&Sums<T>::hidden_dynamics, r * hp, n.hidden, grad.dynamics + r * n.hidden);
        add_up(&Sums<T>::readout_dynamics, r * op, n.classes, grad.dynamics + 3 * n.hidden + r * n.classes);
    }
}

template bool small_forward<NT_REAL>(const Net<NT_REAL>&, const Layout&, const Outputs<NT_REAL>&, const Tape<NT_REAL>*);
template bool small_infer<NT_REAL>(const Net<NT_REAL>&, const Layout&, const Decisions&);
template void small_backward<NT_REAL>(const Net<NT_REAL>&, const Layout&, const Tape<NT_REAL>&, const Gradients<NT_REAL>&);

}  // namespace neurotact::NT_ISA
