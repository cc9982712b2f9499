// Afferent LIF neurons, from conditioned signals to spikes (neurotact/encoders/afferents.py, neurons.lif_step).
#include "parallel.h"

#include "afferents.hpp"
#include "dispatch.hpp"

namespace neurotact::NT_ISA {
namespace {

// What one trial brings to the loop over time.
template <class T>
struct Strand {
    Population<T> slow{}, rapid{};
    typename VectorOf<T, kLanes>::type last{};
    const T* signal;
    uint8_t* spikes;

    Strand(const Encoding<T>& e, int64_t trial, int first, int count)
        : signal(e.signal + trial * e.trial_stride + first), spikes(e.spikes + trial * e.steps * 2 * e.taxels + first) {
        const int64_t at = trial * e.taxels + first;
        std::memcpy(&slow.membrane, e.sa_membrane + at, count * sizeof(T));
        std::memcpy(&rapid.membrane, e.ra_membrane + at, count * sizeof(T));
        std::memcpy(&slow.silent, e.sa_silent_left + at, count * sizeof(int32_t));
        std::memcpy(&rapid.silent, e.ra_silent_left + at, count * sizeof(int32_t));
        if (e.steps) std::memcpy(&last, e.has_last ? e.last + at : signal, count * sizeof(T));
    }
    void finish(const Encoding<T>& e, int64_t trial, int first, int count) const {
        const int64_t at = trial * e.taxels + first;
        std::memcpy(e.sa_membrane + at, &slow.membrane, count * sizeof(T));
        std::memcpy(e.ra_membrane + at, &rapid.membrane, count * sizeof(T));
        std::memcpy(e.sa_silent_left + at, &slow.silent, count * sizeof(int32_t));
        std::memcpy(e.ra_silent_left + at, &rapid.silent, count * sizeof(int32_t));
        if (e.steps) std::memcpy(e.last + at, &last, count * sizeof(T));
    }
    NT_INLINE void step(const Constants<T>& sa, const Constants<T>& ra, int64_t time_stride, int taxels, int count) {
        typename VectorOf<T, kLanes>::type now{};
        std::memcpy(&now, signal, count * sizeof(T));
        uint64_t sa_fired, ra_fired;
        afferent_step(slow, rapid, now, last, sa, ra, sa_fired, ra_fired);
        last = now;
        std::memcpy(spikes, &sa_fired, count);
        std::memcpy(spikes + taxels, &ra_fired, count);
        signal += time_stride;
        spikes += 2 * taxels;
    }
};

// `N` trials side by side: a step waits for the one before it, and another trial's fills the gap.
template <class T, int N>
void encode_lanes(const Encoding<T>& e, int64_t trial, int first, int count) {
    using V = typename VectorOf<T, kLanes>::type;
    const auto fill = [](T value) __attribute__((always_inline)) { return V{} + value; };
    Constants<T> sa{fill(e.sa_gain), fill(e.decay), fill(e.v_rest), fill(e.v_reset), fill(e.v_threshold), {}};
    Constants<T> ra = sa;
    ra.gain = fill(e.ra_gain);
    sa.silent_steps += e.sa_silent;
    ra.silent_steps += e.ra_silent;
    if constexpr (N == 1) {
        Strand<T> strand(e, trial, first, count);
        for (int64_t t = 0; t < e.steps; t++) strand.step(sa, ra, e.time_stride, e.taxels, count);
        strand.finish(e, trial, first, count);
    } else {
        Strand<T> one(e, trial, first, kLanes), two(e, trial + 1, first, kLanes);
        for (int64_t t = 0; t < e.steps; t++) {
            one.step(sa, ra, e.time_stride, e.taxels, kLanes);
            two.step(sa, ra, e.time_stride, e.taxels, kLanes);
        }
        one.finish(e, trial, first, kLanes);
        two.finish(e, trial + 1, first, kLanes);
    }
}

// `N` trials side by side, as above; spikes go into a tally.
template <class T, int N>
void tally_lanes(const TalliedPopulation<T>& e, int64_t trial, int first) {
    using V = typename VectorOf<T, kLanes>::type;
    const auto fill = [](T value) __attribute__((always_inline)) { return V{} + value; };
    Constants<T> constants{fill(e.gain), fill(e.decay), fill(e.v_rest), fill(e.v_reset), fill(e.v_threshold), {}};
    constants.silent_steps += e.silent;
    Population<T> of[N]{};
    const T* felt[N];
    int64_t end = 0;
    for (int k = 0; k < N; k++) {
        of[k].membrane = constants.v_rest;
        felt[k] = e.felt + (trial + k) * e.steps * e.taxels + first;
        end = e.tally.ends[trial + k] > end ? e.tally.ends[trial + k] : end;
    }
    for (int64_t begin = 0; begin < end; begin += 8) {
        const int n_steps = int(end - begin < 8 ? end - begin : 8);
        uint64_t fired[N]{};  // a byte for each taxel, a bit for each step
        for (int step = 0; step < n_steps; step++) {
#pragma GCC unroll 4
            for (int k = 0; k < N; k++) {
                V now;
                std::memcpy(&now, felt[k] + (begin + step) * e.taxels, sizeof now);
                fired[k] |= lif_step(of[k], constants.gain * now, constants) << step;
            }
        }
        for (int k = 0; k < N; k++) e.tally.mark_eight_steps(trial + k, first, fired[k], begin);
    }
}

}  // namespace

template <class T>
void tally(const TalliedPopulation<T>& e) {
    constexpr int kAtOnce = 4;
#pragma omp parallel for num_threads(e.threads) schedule(dynamic, 4)
    for (int64_t four = 0; four < (e.trials + kAtOnce - 1) / kAtOnce; four++) {
        const int64_t first = four * kAtOnce, last = first + kAtOnce;
        for (int taxel = 0; taxel < e.taxels; taxel += kLanes) {
            if (last <= e.trials) {
                tally_lanes<T, kAtOnce>(e, first, taxel);
            } else {
                for (int64_t trial = first; trial < e.trials; trial++) tally_lanes<T, 1>(e, trial, taxel);
            }
        }
    }
}

template void tally<NT_REAL>(const TalliedPopulation<NT_REAL>&);

template <class T>
void encode(const Encoding<T>& e) {
    const int groups = (e.taxels + kLanes - 1) / kLanes;
    const int64_t pairs = (e.trials + 1) / 2;
#pragma omp parallel for num_threads(e.threads) schedule(dynamic, 4) collapse(2)
    for (int64_t pair = 0; pair < pairs; pair++)
        for (int group = 0; group < groups; group++) {
            const int first = group * kLanes, left = e.taxels - first;
            if (left >= kLanes && 2 * pair + 1 < e.trials) {
                encode_lanes<T, 2>(e, 2 * pair, first, kLanes);
            } else {
                for (int64_t trial = 2 * pair; trial < 2 * pair + 2 && trial < e.trials; trial++)
                    encode_lanes<T, 1>(e, trial, first, left < kLanes ? left : kLanes);
            }
        }
}

template void encode<NT_REAL>(const Encoding<NT_REAL>&);

}  // namespace neurotact::NT_ISA
