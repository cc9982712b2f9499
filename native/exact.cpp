// Afferent LIF neurons in closed form, once per sample (neurotact/encoders/closed_form.py, neurons.exact_lif_interval).
// Operations are those of the definition, in its order. Logarithms and exponentials are libm's, NumPy's may differ in
// the last bit.
#include "parallel.h"

#include <algorithm>
#include <cmath>

#include "dispatch.hpp"
#include "simd.hpp"

namespace neurotact::NT_ISA {
namespace {

constexpr double kAtOnce = 1e-9;  // AT_ONCE

// The steps that end within the intervals of `samples`.
template <class T>
NT_INLINE int64_t complete(const ExactEncoding<T>& e, int64_t samples) {
    return int64_t(samples * e.steps_per_sample + kAtOnce);
}

// The steps in which a sample's spikes can be, and its begin in steps.
struct Interval {
    double begin;
    int64_t first, last;
};

// Marks the spikes of one afferent in an interval and leaves its state at the end of it; `begin_ms`: awake from there on.
template <class T, class Sink>
void fire(const ExactEncoding<T>& e, const Interval& interval, double target, double t_ref_ms, double begin_ms,
          double& membrane, double& refractory_ms, const Sink& sink) {
    const auto mark = [&](double time_ms) __attribute__((always_inline)) {
        const int64_t step = int64_t(std::ceil(interval.begin + time_ms * e.steps_per_ms - kAtOnce)) - 1;
        sink(std::clamp(step, interval.first, interval.last));
    };
    const double room = target - e.v_threshold;
    const double first = std::min(begin_ms + e.tau_ms * std::log((target - membrane) / room), e.sample_ms);
    double since = e.sample_ms - first;
    mark(first);
    if (since >= t_ref_ms) {  // else the next spike, at least t_ref later, is beyond the interval
        const double isi = t_ref_ms + e.tau_ms * std::log((target - e.v_reset) / room);
        const int64_t later = int64_t(since / isi);
        for (int64_t nth = 1; nth <= later; nth++) mark(first + double(nth) * isi);
        since = e.sample_ms - (first + double(later) * isi);
    }
    const double awake = std::max(since - t_ref_ms, 0.0);
    membrane = target + (e.v_reset - target) * (awake > 0 ? std::exp(-awake / e.tau_ms) : 1.0);
    refractory_ms = std::max(t_ref_ms - since, 0.0);
}

// sink: called with an afferent and the step of each of its spikes, in order; several may be in one step.
template <class T, class Sink>
void encode_trial(const ExactEncoding<T>& e, int64_t trial, double below_threshold, double decay, const Sink& sink) {
    const T* drive = e.drive + trial * e.samples * e.afferents;
    double* membranes = e.membrane + trial * e.afferents;
    double* waits = e.refractory_ms + trial * e.afferents;
    for (int64_t n = 0; n < e.samples; n++, drive += e.afferents) {
        const int64_t before = e.samples_before + n;
        const Interval interval{double(before) * e.steps_per_sample, complete(e, before), complete(e, before + 1)};
        for (int i = 0; i < e.afferents; i++) {
            const double target = e.v_rest + double(drive[i]);
            const double membrane = membranes[i] > below_threshold ? below_threshold : membranes[i];
            const double begin_ms = std::min(waits[i], e.sample_ms);
            const double left = begin_ms > 0 ? std::exp((begin_ms - e.sample_ms) / e.tau_ms) : decay;
            const double after = target + (membrane - target) * left;
            waits[i] -= begin_ms;
            membranes[i] = after;
            if (after >= e.v_threshold && target > e.v_threshold) {
                membranes[i] = membrane;
                fire(e, interval, target, e.t_ref_ms[i], begin_ms, membranes[i], waits[i],
                     [&](int64_t step) __attribute__((always_inline)) { sink(i, step); });
            }
        }
    }
}

}  // namespace

template <class T>
void encode_exact(const ExactEncoding<T>& e) {
    // Rounding could leave a membrane at the threshold that it has not crossed.
    const double below_threshold = std::nextafter(e.v_threshold, -HUGE_VAL);
    const double decay = std::exp(-e.sample_ms / e.tau_ms);
#pragma omp parallel for num_threads(e.threads) schedule(dynamic, 4)
    for (int64_t trial = 0; trial < e.trials; trial++) {
        if (e.tally) {
            const Tally& tally = *e.tally;
            encode_trial(e, trial, below_threshold, decay, [&](int i, int64_t step) __attribute__((always_inline)) {
                if (step < tally.ends[trial] && step != tally.last[trial * tally.pitch + i]) tally.mark(trial, i, step);
            });
        } else {
            uint8_t* spikes = e.spikes + trial * e.steps * e.afferents;
            encode_trial(e, trial, below_threshold, decay, [&](int i, int64_t step) __attribute__((always_inline)) {
                spikes[(step - e.first_step) * e.afferents + i] = 1;
            });
        }
    }
}

template void encode_exact<NT_REAL>(const ExactEncoding<NT_REAL>&);

}  // namespace neurotact::NT_ISA
