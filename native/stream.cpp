// A chain that takes samples as they come, one at a time, and asks for no memory: conditioning as in
// neurotact/data/conditioning.py, afferents, windows as in streams/windows.py, network and exit. Every operation is
// that of the whole trial, in its order, so that spikes and decisions are equal to the last bit.
#include <new>
#include <utility>

#include "afferents.hpp"
#include "decide.hpp"
#include "dispatch.hpp"

namespace neurotact::NT_ISA {
namespace {

using T = float;
using V = VectorOf<T, kLanes>::type;

// A window under way.
template <class Readout>
struct Window {
    InferState<T, Readout> net;
    uint64_t* waiting;  // input spikes since the network's last step, as bits
    typename Readout::Value* counts;
    Leader<typename Readout::Value> leader;
    int64_t numbers[7];  // window, start, steps, input spikes, hidden spikes, steps on repeated samples, operations

    Window(const Net<T>& of, const ForwardTables<T>& tables, Carver& carver)
        : net(of, tables, carver), waiting(carver.take<uint64_t>(words(of.sizes.inputs))),
          counts(carver.take<typename Readout::Value>(of.sizes.classes)),
          leader{counts, of.sizes.classes} {}
    // Of the afferents that spike now, the number of those that have not done so since the network's last step.
    NT_INLINE int64_t wait(const uint32_t* arriving, int n) {
        int64_t n_new = 0;
        for (int e = 0; e < n; e++) {
            uint64_t& word = waiting[arriving[e] / 64];
            const uint64_t bit = 1ull << (arriving[e] % 64);
            n_new += !(word & bit);
            word |= bit;
        }
        return n_new;
    }
};

// Of the whole stream: samples and steps taken, the windows' clock and their number.
struct Counters {
    int64_t samples, steps, silent, free_at, n_windows, under_way;
};

template <class Readout>
struct Streaming {
    ForwardTables<T> tables;
    Counters at{};
    int groups;
    int kinds;                                           // afferents under a taxel
    Constants<T>* constants;                             // (kind)
    Population<T>* populations;                          // (group of taxels, kind)
    bool* is_empty;                                      // (group of taxels, kind): there is no such afferent
    T *smoothed, *before, *level, *last, *signal;        // (taxel), padded to whole groups
    double* total;
    int64_t* order;                                      // windows under way, the oldest first
    Window<Readout>** windows;
    uint32_t* arriving;

    Streaming(const StreamPlan& plan, Carver& carver)
        : tables(plan.net, carver), groups((plan.taxels + kLanes - 1) / kLanes),
          kinds(plan.n_slow + plan.n_rapid), constants(carver.take<Constants<T>>(kinds)),
          populations(carver.take<Population<T>>(groups * kinds)), is_empty(carver.take<bool>(groups * kinds)),
          smoothed(carver.take<T>(groups * kLanes)), before(carver.take<T>(groups * kLanes)),
          level(carver.take<T>(groups * kLanes)), last(carver.take<T>(groups * kLanes)),
          signal(carver.take<T>(groups * kLanes)), total(carver.take<double>(groups * kLanes)),
          order(carver.take<int64_t>(plan.at_once)), windows(carver.take<Window<Readout>*>(plan.at_once)),
          arriving(carver.take<uint32_t>(kinds * plan.taxels)) {
        for (int i = 0; i < plan.at_once; i++) {
            void* here = carver.take<Window<Readout>>(1);
            if (here) {
                windows[i] = new (here) Window<Readout>(plan.net, tables, carver);
            } else {
                Window<Readout>(plan.net, tables, carver);
            }
        }
        if (!populations) return;
        const auto fill = [](T value) __attribute__((always_inline)) { return V{} + value; };
        for (int k = 0; k < kinds; k++) {
            constants[k] = Constants<T>{fill(plan.gains[k]), fill(plan.decay),       fill(plan.v_rest),
                                        fill(plan.v_reset),  fill(plan.v_threshold), {}};
            constants[k].silent_steps += k < plan.n_slow ? plan.sa_silent : plan.ra_silent;
        }
        for (int k = 0; k < kinds; k++)
            for (int g = 0; g < groups; g++) {
                bool empty = plan.numbers != nullptr;
                for (int i = g * kLanes; empty && i < (g + 1) * kLanes && i < plan.taxels; i++)
                    empty = plan.numbers[k * plan.taxels + i] < 0;
                is_empty[g * kinds + k] = empty;
            }
        begin(plan);
        for (int i = 0; i < plan.at_once; i++) start_window(plan, *windows[i]);
    }

    // As before the first sample of a trial; windows go on being numbered.
    void begin(const StreamPlan& plan) {
        const int64_t n_windows = at.n_windows;
        at = {};
        at.n_windows = n_windows;
        at.silent = plan.quiet;
        for (int i = 0; i < groups * kinds; i++) {
            populations[i].membrane = V{} + plan.v_rest;
            populations[i].silent -= populations[i].silent;
        }
        for (int i = 0; i < groups * kLanes; i++) smoothed[i] = before[i] = level[i] = last[i] = signal[i] = 0;
        for (int i = 0; i < groups * kLanes; i++) total[i] = 0;
        for (int i = 0; i < plan.at_once; i++) order[i] = i;
    }

    void start_window(const StreamPlan& plan, Window<Readout>& window) {
        window.net.start(plan.net, tables, window.counts);
        window.leader = {window.counts, plan.net.sizes.classes};
        std::memset(window.waiting, 0, words(plan.net.sizes.inputs) * sizeof(uint64_t));
        for (int64_t& number : window.numbers) number = 0;
        window.numbers[0] = at.n_windows;
        window.numbers[1] = at.steps;
    }

    NT_INLINE void condition(const StreamPlan& plan) {
        const int64_t step = at.steps;
        for (int i = 0; i < plan.taxels; i++) {
            T value = signal[i];
            switch (plan.baseline) {
                case Baseline::none: break;
                case Baseline::first:
                    if (step == 0) level[i] = value;
                    value -= level[i];
                    break;
                case Baseline::high_pass:
                    if (step == 0) level[i] = value;
                    level[i] = plan.base_new * value + plan.base_kept * level[i];
                    value -= level[i];
                    break;
                default:
                    const bool moves = plan.baseline == Baseline::running || step < plan.start_steps;
                    if (moves) total[i] += value;
                    const int64_t heard = moves ? step + 1 : plan.start_steps;
                    value -= (T)(total[i] / (double)heard);
            }
            if (plan.offset) value = (value - plan.offset[i]) / plan.scale[i];
            signal[i] = plan.rectify && value < 0 ? -value : value;
        }
    }

    // Numbers of the afferents that spike, ascending; those of a kind wait behind the place of the kinds before it.
    NT_INLINE int encode(const StreamPlan& plan) {
        if (at.steps == 0) std::memcpy(last, signal, groups * kLanes * sizeof(T));
        int n = 0;
        for (int k = 0; k < kinds; k++) {
            const int first = k * plan.taxels;
            int n_fired = 0;
            for (int g = 0; g < groups; g++) {
                if (is_empty[g * kinds + k]) continue;
                V now, earlier;
                std::memcpy(&now, signal + g * kLanes, sizeof now);
                std::memcpy(&earlier, last + g * kLanes, sizeof earlier);
                const V drive = constants[k].gain * (k < plan.n_slow ? now : change_of<T>(now, earlier));
                const uint64_t fired = lif_step(populations[g * kinds + k], drive, constants[k]);
                n_fired = list(plan, fired, g * kLanes, first, arriving + first, n_fired);
            }
            for (int e = 0; e < n_fired; e++) arriving[n++] = arriving[first + e];
        }
        std::memcpy(last, signal, groups * kLanes * sizeof(T));
        return n;
    }
    // Of the taxels of a group whose byte is 1, the afferents; without those of taxels that only fill up the last group,
    // or have none of this kind.
    static NT_INLINE int list(const StreamPlan& plan, uint64_t fired, int first, int offset, uint32_t* to, int n) {
        for (; fired; fired &= fired - 1) {
            const int taxel = first + lowest(fired) / 8;
            if (taxel >= plan.taxels) break;
            const int32_t number = plan.numbers ? plan.numbers[offset + taxel] : offset + taxel;
            if (number >= 0) to[n++] = (uint32_t)number;
        }
        return n;
    }

    NT_INLINE bool opens(const StreamPlan& plan, bool has_spike) {
        const int64_t now = at.steps;
        const bool opened = plan.hop ? now >= plan.start && (now - plan.start) % plan.hop == 0
                                     : has_spike && at.silent >= plan.quiet && now >= plan.start && now >= at.free_at;
        at.silent = has_spike ? 0 : at.silent + 1 < plan.quiet ? at.silent + 1 : plan.quiet;
        if (opened) at.free_at = now + plan.length;
        return opened;
    }

    // One step of the encoder's clock, `signal` being smoothed; decisions are written from `to` on.
    NT_INLINE int64_t step(const StreamPlan& plan, bool held, Decided* to) {
        condition(plan);
        const int n_arriving = encode(plan);
        if (opens(plan, n_arriving > 0)) {
            start_window(plan, *windows[order[at.under_way++]]);
            at.n_windows++;
        }
        StreamTrace* trace = plan.trace && plan.trace->steps < plan.trace->room ? plan.trace : nullptr;
        if (trace) write_down(plan, *trace, n_arriving);
        at.steps++;
        int64_t n_decided = 0, left = 0;
        for (int64_t i = 0; i < at.under_way; i++) {
            const int64_t slot = order[i];
            Window<Readout>& window = *windows[slot];
            window.numbers[2]++;
            window.numbers[3] += window.wait(arriving, n_arriving);
            window.numbers[5] += held;
            const bool is_over = window.numbers[2] >= plan.length;
            const bool is_due = is_over || window.numbers[2] % plan.bin == 0;
            const int n_sent = is_due ? advance(plan, window) : 0;
            if (trace && i == 0) {
                trace->window[trace->steps - 1] = window.numbers[0];
                mark(window.net.sent, n_sent, trace->hidden + (trace->steps - 1) * words(plan.net.sizes.hidden));
            }
            window.numbers[4] += n_sent;
            if (is_over || (is_due && window.leader.exits(plan.rule))) {
                const int64_t* n = window.numbers;
                to[n_decided++] = {n[0], n[1], n[2], window.leader.told(plan.rule), n[3], n[4], n[5], window.leader.heard, n[6]};
            } else {
                std::swap(order[left++], order[i]);
            }
        }
        at.under_way = left;
        return n_decided;
    }

    // One step of the network, from the spikes that wait; how many hidden neurons spike.
    NT_INLINE int advance(const StreamPlan& plan, Window<Readout>& window) {
        const int64_t n_words = words(plan.net.sizes.inputs);
        const int n_rows = list_rows(window.waiting, n_words, 0, window.net.rows, 0);
        std::memset(window.waiting, 0, n_words * sizeof(uint64_t));
        const int64_t now = (window.numbers[2] + plan.bin - 1) / plan.bin - 1;
        if (plan.fans) window.numbers[6] += operations(plan.fans, window.net.rows, n_rows);
        const int n_sent = plan.net.adaptation.on
                               ? window.net.template step<true>(plan.net, tables, n_rows, now, window.leader)
                               : window.net.template step<false>(plan.net, tables, n_rows, now, window.leader);
        if (plan.fans) window.numbers[6] += operations(plan.fans + plan.net.sizes.inputs, window.net.sent, n_sent);
        return n_sent;
    }
    // One at each synapse of the neurons that spike.
    static NT_INLINE int64_t operations(const float* fans, const uint32_t* rows, int n) {
        int64_t total = 0;
        for (int e = 0; e < n; e++) total += (int64_t)fans[rows[e]];
        return total;
    }

    // A step's afferents, and room for what the oldest window makes of them.
    void write_down(const StreamPlan& plan, StreamTrace& trace, int n_arriving) {
        const int64_t row = trace.steps++, n_in = words(plan.net.sizes.inputs), n_hidden = words(plan.net.sizes.hidden);
        if (row == 0) trace.first = at.steps;
        std::memset(trace.afferents + row * n_in, 0, n_in * sizeof(uint64_t));
        std::memset(trace.hidden + row * n_hidden, 0, n_hidden * sizeof(uint64_t));
        trace.window[row] = -1;
        mark(arriving, n_arriving, trace.afferents + row * n_in);
    }
    static void mark(const uint32_t* neurons, int n, uint64_t* to) {
        for (int e = 0; e < n; e++) to[neurons[e] / 64] |= 1ull << (neurons[e] % 64);
    }

    int64_t push(const StreamPlan& plan, const float* samples, int64_t n, bool held, Decided* to) {
        int64_t n_decided = 0;
        if (plan.trace) plan.trace->steps = 0;
        for (const float* sample = samples; sample < samples + n * plan.taxels; sample += plan.taxels) {
            for (int i = 0; i < plan.taxels; i++) {
                const T raw = plan.factor == 1 ? sample[i] : sample[i] * plan.factor;
                if (plan.smooth)
                    smoothed[i] = plan.smooth_new * raw + plan.smooth_kept * (at.samples ? smoothed[i] : raw);
                else
                    smoothed[i] = raw;
            }
            at.samples++;
            if (!plan.resampled) {
                std::memcpy(signal, smoothed, plan.taxels * sizeof(T));
                n_decided += step(plan, held, to + n_decided);
                continue;
            }
            // Linear interpolation between the sample before and this one.
            for (;;) {
                const double position = (double)at.steps * plan.samples_per_step;
                const int64_t whole = (int64_t)position;
                const bool is_now = whole + 1 == at.samples;
                if (is_now ? position > (double)whole : whole + 2 != at.samples) break;
                const T weight = (T)(position - (double)whole);
                for (int i = 0; i < plan.taxels; i++)
                    signal[i] = is_now ? smoothed[i] : before[i] + weight * (smoothed[i] - before[i]);
                n_decided += step(plan, held, to + n_decided);
            }
            std::memcpy(before, smoothed, plan.taxels * sizeof(T));
        }
        return n_decided;
    }

    void visit(const StreamPlan& plan, const Visitor& visitor) {
        const auto part = [&](void* at, size_t bytes) { visitor.visit(visitor.to, at, bytes); };
        const size_t lanes = groups * kLanes * sizeof(T);
        part(&at, sizeof at);
        part(smoothed, lanes);
        part(level, lanes);
        part(last, lanes);
        part(total, 2 * lanes);
        for (int i = 0; i < groups * kinds; i++) {
            part(&populations[i].membrane, sizeof(V));
            part(&populations[i].silent, sizeof populations[i].silent);
        }
        std::memcpy(before, smoothed, lanes);  // between samples they are the same
        for (int64_t i = 0; i < at.under_way; i++) {
            Window<Readout>& window = *windows[order[i]];
            const Sizes& n = plan.net.sizes;
            part(window.numbers, (plan.fans ? 7 : 6) * sizeof(int64_t));
            part(window.waiting, words(n.inputs) * sizeof(uint64_t));
            part(window.net.current, n.hidden * sizeof(T));
            part(window.net.membrane, n.hidden * sizeof(T));
            part(window.net.spikes.now, words(n.hidden) * sizeof(uint64_t));
            part(window.net.spikes.before, words(n.hidden) * sizeof(uint64_t));
            if (window.net.adaptation) part(window.net.adaptation, n.hidden * sizeof(T));
            window.net.readout.each_part(part);
            part(window.counts, n.classes * sizeof(typename Readout::Value));
            part(&window.leader.index, 3 * sizeof(int64_t));  // index, standing, standing_since_spike
            part(&window.leader.heard, sizeof(bool));
        }
    }
};

template <class Readout>
constexpr StreamKernels kernels_with() {
    using S = Streaming<Readout>;
    return {
        [](const StreamPlan& plan) -> size_t {
            Carver measure;
            measure.take<S>(1);
            S(plan, measure);
            return measure.bytes();
        },
        [](const StreamPlan& plan, char* block) -> void* {
            Carver carver(block);
            void* here = carver.take<S>(1);
            return new (here) S(plan, carver);
        },
        [](const StreamPlan& plan, void* stream, const float* samples, int64_t n, bool held, Decided* to) {
            return static_cast<S*>(stream)->push(plan, samples, n, held, to);
        },
        [](const StreamPlan& plan, void* stream) { static_cast<S*>(stream)->begin(plan); },
        [](const StreamPlan& plan, void* stream, const Visitor& to) { static_cast<S*>(stream)->visit(plan, to); },
    };
}

constexpr StreamKernels counting = kernels_with<SpikingReadout<T>>();
constexpr StreamKernels integrating = kernels_with<IntegratingReadout<T>>();

const StreamKernels& of(const StreamPlan& plan) { return plan.net.bias ? integrating : counting; }

}  // namespace

const StreamKernels stream_kernels{
    [](const StreamPlan& plan) { return of(plan).bytes(plan); },
    [](const StreamPlan& plan, char* block) { return of(plan).make(plan, block); },
    [](const StreamPlan& plan, void* stream, const float* samples, int64_t n, bool held, Decided* to) {
        return of(plan).push(plan, stream, samples, n, held, to);
    },
    [](const StreamPlan& plan, void* stream) { of(plan).begin(plan, stream); },
    [](const StreamPlan& plan, void* stream, const Visitor& to) { of(plan).visit(plan, stream, to); },
};

}  // namespace neurotact::NT_ISA
