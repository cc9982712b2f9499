// The fused network of up to 64 hidden and 16 readout neurons, the studies' own size: the state of two trials stays in
// registers over the whole window, spikes are one word a step, and sums cost what the spikes cost. Two trials at once
// hide each other's latencies and share every load of a weight in the dense product of the backward pass.
//
// A spike s[t] of the hidden layer goes into I[t+1+d] of that layer, d the recurrent delay, and into the readout: at
// step t under `eq4` and `delayed`, at step t-1 under `immediate`. So that one list of events serves both, the readout
// runs a step behind (`lag`) under `immediate`, and with a delay, which is known here under `delayed` alone: turn t of
// the loop takes s[t-d] into step t of the hidden layer and into step t-lag of the readout.
#include "parallel.h"

#include "dispatch.hpp"
#include "memory.hpp"
#include "spikes.hpp"
#include "step.hpp"

namespace neurotact::NT_ISA {
namespace {

constexpr int kPair = 2;    // trials side by side; an odd one runs beside a silent one
constexpr int kBlock = 8;   // trials whose gradients are summed in one go
constexpr int kRows = 65;   // rows of a word's table: 64 neurons, then a row of zeros for "no more spikes"

template <class T>
constexpr int kNarrow = kWide<T> < 8 ? kWide<T> : 8;

// Sizes and vectors of one instantiation: HP hidden and OP readout lanes.
template <class T, int HP, int OP>
struct Form {
    using SH = Simd<T, kWide<T>>;
    using SO = Simd<T, kNarrow<T>>;
    static constexpr int NH = HP / SH::lanes, NO = OP / SO::lanes;
    static constexpr int pitch = round_up(HP + OP, 64 / (int)sizeof(T));  // of an event's row
};

template <class S, int N>
struct Vectors {
    typename S::V v[N];
    NT_INLINE typename S::V& operator[](int q) { return v[q]; }
    NT_INLINE const typename S::V& operator[](int q) const { return v[q]; }
};
template <class S, int N, class T>
NT_INLINE Vectors<S, N> load_all(const T* at) {
    Vectors<S, N> to;
    for (int q = 0; q < N; q++) to[q] = load<S>(at + q * S::lanes);
    return to;
}
template <class S, int N, class T>
NT_INLINE void store_all(T* at, const Vectors<S, N>& from) {
    for (int q = 0; q < N; q++) store(at + q * S::lanes, from[q]);
}

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

NT_INLINE int64_t event_row(int event) { return (int64_t)(event / 64) * kRows + event % 64; }

template <class T>
Tables<T> forward_tables(const Net<T>& net, const Layout& layout, Carver& carver) {
    const Sizes& n = net.sizes;
    const int hp = layout.hidden_pitch, pitch = round_up(hp + layout.readout_pitch, 64 / (int)sizeof(T));
    const int64_t count = words(n.inputs + n.hidden) * kRows * pitch;
    T* table = carver.take<T>(count);
    if (table) {
        std::memset(table, 0, count * sizeof(T));
        for (int i = 0; i < n.inputs; i++)
            std::memcpy(table + event_row(i) * pitch, net.w_in + (int64_t)i * n.hidden, n.hidden * sizeof(T));
        for (int i = 0; i < n.hidden; i++) {
            T* row = table + event_row(n.inputs + i) * pitch;
            std::memcpy(row, net.w_rec + (int64_t)i * n.hidden, n.hidden * sizeof(T));
            std::memcpy(row + hp, net.w_out + (int64_t)i * n.classes, n.classes * sizeof(T));
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
    return {nullptr, transposed(net.w_rec, n.hidden, n.hidden, layout.hidden_pitch, carver),
            transposed(net.w_out, n.hidden, n.classes, layout.hidden_pitch, carver)};
}

// ---- forward -------------------------------------------------------------------------------------------------------

// One layer of one trial.
template <class S, int N>
struct Layer {
    Vectors<S, N> current{}, membrane{}, count{};
    typename S::Mask fired[N];  // U > threshold: whom the reset acts on
    uint64_t spikes = 0;
};

template <Membrane M, Reset R, class S, int N>
NT_INLINE void advance(Layer<S, N>& layer, const Vectors<S, N>& before, typename S::V beta, typename S::V threshold,
                       uint64_t lanes) {
    uint64_t spikes = 0;
    for (int q = 0; q < N; q++) {
        layer.membrane[q] =
            membrane_step<S, M, R>(layer.membrane[q], before[q], layer.current[q], layer.fired[q], beta, threshold);
        layer.fired[q] = S::greater(layer.membrane[q], threshold);
        layer.count[q] += S::only(layer.fired[q], typename S::V{} + 1);
        spikes |= (uint64_t)S::bits(layer.fired[q]) << (q * S::lanes);
    }
    layer.spikes = spikes & lanes;
}

template <Membrane M, int D>
constexpr int64_t kLag = M == Membrane::immediate || D ? 1 : 0;

template <class S, int N, class T>
NT_INLINE void write_counts(Layer<S, N>& layer, bool last_is_sent, int n, T* to) {
    if (to == nullptr) return;
    alignas(64) T counts[N * S::lanes];
    if (!last_is_sent)
        for (int q = 0; q < N; q++) layer.count[q] -= S::only(layer.fired[q], typename S::V{} + 1);
    store_all(counts, layer.count);
    std::memcpy(to, counts, n * sizeof(T));
}

template <class T, int HP, int OP, Membrane M, Reset R, int D>
void forward_trials(const Net<T>& net, const Tables<T>& tables, int64_t first, const uint64_t* inputs,
                    const Outputs<T>& out, const Tape<T>* tape) {
    using F = Form<T, HP, OP>;
    using SH = typename F::SH;
    using SO = typename F::SO;
    constexpr int NH = F::NH, NO = F::NO, N = kPair;
    const Sizes& n = net.sizes;
    const auto alpha = all<SH>(net.hidden.alpha[0]), beta = all<SH>(net.hidden.beta[0]);
    const auto threshold = all<SH>(net.hidden.threshold[0]);
    const auto alpha_out = all<SO>(net.readout.alpha[0]), beta_out = all<SO>(net.readout.beta[0]);
    const auto threshold_out = all<SO>(net.readout.threshold[0]);
    const uint64_t hidden_lanes = n.hidden == 64 ? ~0ull : (1ull << n.hidden) - 1;
    const Events list(n);
    const int64_t steps = n.steps;
    constexpr int64_t lag = kLag<M, D>;
    uint64_t spikes_before[N] = {};  // s[t-1], for turn t of a network with a delay
    Layer<SH, NH> hidden[N];
    Layer<SO, NO> readout[N];
    for (int s = 0; s < N; s++) {
        for (auto& fired : hidden[s].fired) fired = SH::greater(typename SH::V{}, threshold);
        for (auto& fired : readout[s].fired) fired = SO::greater(typename SO::V{}, threshold_out);
    }
    T* membrane = tape ? tape->membrane + first * steps * HP : nullptr;
    T* readout_membrane = tape ? tape->readout_membrane + first * steps * OP : nullptr;
    uint64_t* spikes = tape ? tape->spikes + first * steps : nullptr;
    const auto write_readout = [&](int s, int64_t step) __attribute__((always_inline)) {
        if (readout_membrane) store_all(readout_membrane + (s * steps + step) * OP, readout[s].membrane);
    };
    for (int64_t t = 0; t < steps; t++) {
        Vectors<SH, NH> before[N];
        Vectors<SO, NO> before_out[N];
        for (int s = 0; s < N; s++) {
            before[s] = hidden[s].current;
            before_out[s] = readout[s].current;
            for (int q = 0; q < NH; q++) hidden[s].current[q] = alpha * before[s][q];
            for (int q = 0; q < NO; q++) readout[s].current[q] = alpha_out * before_out[s][q];
        }
        for (int k = 0; k < list.n_words; k++) {
            uint64_t events[N];
            for (int s = 0; s < N; s++)
                events[s] = list(k, inputs + (s * steps + t) * list.in_words, D ? spikes_before[s] : hidden[s].spikes);
            const T* table = tables.events + k * kRows * F::pitch;
            while (any(events))
                for (int s = 0; s < N; s++) {
                    const T* row = table + lowest(events[s]) * F::pitch;
                    events[s] &= events[s] - 1;
                    for (int q = 0; q < NH; q++) hidden[s].current[q] += load<SH>(row + q * SH::lanes);
                    for (int q = 0; q < NO; q++) readout[s].current[q] += load<SO>(row + HP + q * SO::lanes);
                }
        }
        for (int s = 0; s < N; s++) {
            if (D) spikes_before[s] = hidden[s].spikes;
            advance<M, R>(hidden[s], before[s], beta, threshold, hidden_lanes);
            if (t >= lag) {
                advance<M, R>(readout[s], before_out[s], beta_out, threshold_out, ~0ull);
                write_readout(s, t - lag);
            }
            if (membrane) {
                store_all(membrane + (s * steps + t) * HP, hidden[s].membrane);
                spikes[s * steps + t] = hidden[s].spikes;
            }
        }
    }
    if (lag && steps)
        for (int s = 0; s < N; s++) {
            const uint64_t sent = D ? spikes_before[s] : hidden[s].spikes;
            const Vectors<SO, NO> before_out = readout[s].current;
            for (int q = 0; q < NO; q++) readout[s].current[q] = alpha_out * before_out[q];
            for (int i = 0; i < n.hidden; i++)
                if (sent >> i & 1)
                    for (int q = 0; q < NO; q++)
                        readout[s].current[q] +=
                            load<SO>(tables.events + event_row(n.inputs + i) * F::pitch + HP + q * SO::lanes);
            advance<M, R>(readout[s], before_out, beta_out, threshold_out, ~0ull);
            write_readout(s, steps - 1);
        }
    const bool last_is_sent = M == Membrane::immediate || steps == 0;
    for (int s = 0; s < N && first + s < n.trials; s++) {
        if (out.hidden) write_counts(hidden[s], last_is_sent, n.hidden, out.hidden + (first + s) * n.hidden);
        if (out.readout) write_counts(readout[s], last_is_sent, n.classes, out.readout + (first + s) * n.classes);
    }
}

// ---- backward ------------------------------------------------------------------------------------------------------

template <class S, class T>
NT_INLINE void add_at(T* at, typename S::V what) {
    store(at, load<S>(at) + what);
}

template <class S, int N>
struct LayerAdjoint {
    Adjoint<S> lanes[N];
    Vectors<S, N> after;  // U[t+1]
};

// Step t of a layer backwards; `before` is U[t]. Returns dL/dI[t+1].
template <Membrane M, Reset R, class S, int N>
NT_INLINE Vectors<S, N> layer_back(LayerAdjoint<S, N>& layer, const Vectors<S, N>& before,
                                   const Vectors<S, N>& spike_gradient, typename S::V alpha, typename S::V beta,
                                   typename S::V threshold, typename S::V scale) {
    Vectors<S, N> current;
    for (int q = 0; q < N; q++) {
        const auto sloped = surrogate_slope<S>(layer.after[q], threshold, scale) * spike_gradient[q];
        typename S::V through;
        current[q] =
            step_back<S, M, R>(layer.lanes[q], sloped, S::greater(before[q], threshold), alpha, beta, through);
    }
    layer.after = before;
    return current;
}

// sum[s] += g[s] matrix for every trial s: `matrix` has a row a neuron i of g, an even number of rows. Even and odd
// rows are summed apart, so that twice as many additions are under way at a time.
template <class S, int N, int P, class T>
NT_INLINE void add_product(Vectors<S, N> (&sum)[P], const T* g, int g_pitch, const T* matrix, int rows) {
    Vectors<S, N> odd[P]{};
    for (int i = 0; i < rows; i += 2) {
        const Vectors<S, N> w0 = load_all<S, N>(matrix + i * (N * S::lanes));
        const Vectors<S, N> w1 = load_all<S, N>(matrix + (i + 1) * (N * S::lanes));
        for (int s = 0; s < P; s++) {
            const auto g0 = all<S>(g[s * g_pitch + i]), g1 = all<S>(g[s * g_pitch + i + 1]);
            for (int q = 0; q < N; q++) sum[s][q] += g0 * w0[q];
            for (int q = 0; q < N; q++) odd[s][q] += g1 * w1[q];
        }
    }
    for (int s = 0; s < P; s++)
        for (int q = 0; q < N; q++) sum[s][q] += odd[s][q];
}

template <class T, int HP, int OP, Membrane M, Reset R, int D>
void backward_trials(const Net<T>& net, const Tables<T>& tables, const Tape<T>& tape, const Gradients<T>& grad,
                     T* sums, int64_t first) {
    using F = Form<T, HP, OP>;
    using SH = typename F::SH;
    using SO = typename F::SO;
    constexpr int NH = F::NH, NO = F::NO, N = kPair;
    const Sizes& n = net.sizes;
    const auto alpha = all<SH>(net.hidden.alpha[0]), beta = all<SH>(net.hidden.beta[0]);
    const auto threshold = all<SH>(net.hidden.threshold[0]), scale = all<SH>(net.scale);
    const auto alpha_out = all<SO>(net.readout.alpha[0]), beta_out = all<SO>(net.readout.beta[0]);
    const auto threshold_out = all<SO>(net.readout.threshold[0]), scale_out = all<SO>(net.scale);
    const Events list(n);
    const int64_t steps = n.steps;
    constexpr int64_t lag = kLag<M, D>;
    if (steps == 0) return;
    const T* membrane = tape.membrane + first * steps * HP;
    const T* readout_membrane = tape.readout_membrane + first * steps * OP;
    const uint64_t* inputs = tape.inputs + first * steps * list.in_words;
    const uint64_t* spikes = tape.spikes + first * steps;

    alignas(64) T count_gradient[N][HP] = {}, class_gradient[N][OP] = {};
    alignas(64) T g[N][HP], g_out[N][OP];
    LayerAdjoint<SH, NH> hidden[N];
    LayerAdjoint<SO, NO> readout[N];
    Vectors<SH, NH> spike_gradient[N], waiting[N];  // dL/ds[t+1] in turn t; with a delay, dL/ds[t]
    const int64_t last = steps - 1;
    for (int s = 0; s < N; s++) {
        const int64_t trial = first + s;
        const bool real = trial < n.trials;
        if (grad.hidden && real) std::memcpy(count_gradient[s], grad.hidden + trial * n.hidden, n.hidden * sizeof(T));
        if (grad.readout && real) std::memcpy(class_gradient[s], grad.readout + trial * n.classes, n.classes * sizeof(T));
        hidden[s].after = load_all<SH, NH>(membrane + (s * steps + last) * HP);
        readout[s].after = load_all<SO, NO>(readout_membrane + (s * steps + last) * OP);
        spike_gradient[s] = waiting[s] = Vectors<SH, NH>{};
    }
    const int out_rows = n.classes + n.classes % 2, hidden_rows = n.hidden + n.hidden % 2;
    Vectors<SO, NO> current_out[N];
    const auto readout_back = [&](int s, int64_t step) __attribute__((always_inline)) {
        const T* row = readout_membrane + (s * steps + step) * OP;
        const Vectors<SO, NO> before = step ? load_all<SO, NO>(row - OP) : Vectors<SO, NO>{};
        Vectors<SO, NO> decided{};  // s[T] is sent only under `immediate`
        if (M == Membrane::immediate || step < last) decided = load_all<SO, NO>(class_gradient[s]);
        current_out[s] = layer_back<M, R>(readout[s], before, decided, alpha_out, beta_out, threshold_out, scale_out);
        store_all(g_out[s], current_out[s]);
    };
    const auto spikes_at = [&](int s, int64_t step) __attribute__((always_inline)) {
        return step > 0 ? spikes[s * steps + step - 1] : 0;
    };
    // dL/ds[t-D], from where turn t took it: into the readout and, but for the turn after the last step, into the
    // hidden layer.
    const auto gather_spike_gradient = [&](bool into_hidden) __attribute__((always_inline)) {
        auto& gathered = D ? waiting : spike_gradient;
        for (int s = 0; s < N; s++) {
            if (D) spike_gradient[s] = waiting[s];
            gathered[s] = load_all<SH, NH>(count_gradient[s]);
        }
        add_product(gathered, g_out[0], OP, tables.w_out_transposed, out_rows);
        if (into_hidden) add_product(gathered, g[0], HP, tables.w_rec_transposed, hidden_rows);
    };
    if (lag) {
        for (int s = 0; s < N; s++) {
            readout_back(s, last);
            for (int i = 0; i < n.hidden; i++)
                if (spikes_at(s, steps - D) >> i & 1)
                    for (int q = 0; q < NO; q++)
                        add_at<SO>(sums + event_row(n.inputs + i) * F::pitch + HP + q * SO::lanes, current_out[s][q]);
        }
        gather_spike_gradient(false);
    }
    for (int64_t t = last; t >= 0; t--) {
        Vectors<SH, NH> current[N];
        for (int s = 0; s < N; s++) {
            if (t >= lag) readout_back(s, t - lag);
            const T* row = membrane + (s * steps + t) * HP;
            const Vectors<SH, NH> before = t ? load_all<SH, NH>(row - HP) : Vectors<SH, NH>{};
            current[s] = layer_back<M, R>(hidden[s], before, spike_gradient[s], alpha, beta, threshold, scale);
            store_all(g[s], current[s]);
        }
        // dL/dw of every event: dL/dI of the layer it went into.
        for (int k = 0; k < list.n_words; k++) {
            uint64_t events[N];
            for (int s = 0; s < N; s++) {
                events[s] = list(k, inputs + (s * steps + t) * list.in_words, spikes_at(s, t - D));
            }
            T* table = sums + k * kRows * F::pitch;
            while (any(events))
                for (int s = 0; s < N; s++) {
                    T* row = table + lowest(events[s]) * F::pitch;
                    events[s] &= events[s] - 1;
                    for (int q = 0; q < NH; q++) add_at<SH>(row + q * SH::lanes, current[s][q]);
                    for (int q = 0; q < NO; q++) add_at<SO>(row + HP + q * SO::lanes, current_out[s][q]);
                }
        }
        gather_spike_gradient(true);
    }
}

// ---- sizes ---------------------------------------------------------------------------------------------------------

template <class Run>
NT_INLINE void with_form(const Layout& layout, const Run& run) {
    const auto with_readout = [&](auto HP) __attribute__((always_inline)) {
        if (layout.readout_pitch == 8) run(HP, std::integral_constant<int, 8>());
        else run(HP, std::integral_constant<int, 16>());
    };
    switch (layout.hidden_pitch) {
        case 16: return with_readout(std::integral_constant<int, 16>());
        case 32: return with_readout(std::integral_constant<int, 32>());
        case 48: return with_readout(std::integral_constant<int, 48>());
        default: return with_readout(std::integral_constant<int, 64>());
    }
}

template <class T, class Run>
NT_INLINE void with_kernel(const Net<T>& net, const Layout& layout, const Run& run) {
    with_form(layout, [&](auto HP, auto OP) __attribute__((always_inline)) {
        with_variant(net.membrane, net.reset, [&](auto M, auto R) __attribute__((always_inline)) {
            if constexpr (M == Membrane::delayed) {
                if (net.recurrent_delay) return run(HP, OP, M, R, std::integral_constant<int, 1>());
            }
            run(HP, OP, M, R, std::integral_constant<int, 0>());
        });
    });
}

}  // namespace

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
        with_kernel(net, layout, [&](auto HP, auto OP, auto M, auto R, auto D) {
#pragma omp for schedule(dynamic, 4)
            for (int64_t pair = 0; pair < pairs; pair++) {
                const int64_t first = pair * kPair;
                uint64_t* inputs = tape ? tape->inputs + first * trial_words : mine;
                for (int s = 0; s < kPair; s++) {
                    uint64_t* to = inputs + s * trial_words;
                    if (first + s < n.trials) others += !pack_trial(net.spikes, first + s, n.steps, n.inputs, to);
                    else std::memset(to, 0, trial_words * sizeof(uint64_t));
                }
                forward_trials<T, HP.value, OP.value, M.value, R.value, D.value>(net, tables, first, inputs, out, tape);
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
    const int pitch = round_up(layout.hidden_pitch + layout.readout_pitch, 64 / (int)sizeof(T));
    const int64_t sums_size = words(n.inputs + n.hidden) * kRows * pitch;
    Carver measure;
    backward_tables(net, layout, measure);
    Block block(measure.bytes() + groups * sums_size * sizeof(T));
    Carver carver(block.data());
    const Tables<T> tables = backward_tables(net, layout, carver);
    T* all_sums = carver.take<T>(groups * sums_size);
#pragma omp parallel num_threads(net.threads)
    with_kernel(net, layout, [&](auto HP, auto OP, auto M, auto R, auto D) {
#pragma omp for schedule(dynamic, 1)
        for (int group = 0; group < groups; group++) {
            T* sums = all_sums + group * sums_size;
            std::memset(sums, 0, sums_size * sizeof(T));
            const int64_t end = blocks * (group + 1) / groups * kBlock;
            for (int64_t first = blocks * group / groups * kBlock; first < end && first < n.trials; first += kPair)
                backward_trials<T, HP.value, OP.value, M.value, R.value, D.value>(net, tables, tape, grad, sums, first);
        }
    });
    // Group after group, whatever thread did them.
    const auto add_up = [&](int event, int offset, int columns, T* to) {
        for (int c = 0; c < columns; c++) to[c] = 0;
        for (int group = 0; group < groups; group++) {
            const T* from = all_sums + group * sums_size + event_row(event) * pitch + offset;
            for (int c = 0; c < columns; c++) to[c] += from[c];
        }
    };
    for (int i = 0; i < n.inputs; i++) add_up(i, 0, n.hidden, grad.w_in + (int64_t)i * n.hidden);
    for (int i = 0; i < n.hidden; i++) {
        add_up(n.inputs + i, 0, n.hidden, grad.w_rec + (int64_t)i * n.hidden);
        add_up(n.inputs + i, layout.hidden_pitch, n.classes, grad.w_out + (int64_t)i * n.classes);
    }
}

template bool small_forward<NT_REAL>(const Net<NT_REAL>&, const Layout&, const Outputs<NT_REAL>&, const Tape<NT_REAL>*);
template void small_backward<NT_REAL>(const Net<NT_REAL>&, const Layout&, const Tape<NT_REAL>&, const Gradients<NT_REAL>&);

}  // namespace neurotact::NT_ISA
