// Spikes of a raster into a tally (neurotact/encoders/tally.py), for the encoders without a kernel of their own, and what
// else a search for gains repeats.
#include <cstring>

#include "kernels.hpp"

namespace neurotact {

void tally_raster(const uint8_t* spikes, int64_t trials, int64_t trial_stride, int64_t time_stride, int64_t afferents,
                  const Tally& tally) {
    for (int64_t trial = 0; trial < trials; trial++)
        for (int64_t first = 0; first < afferents; first += 8) {
            const uint8_t* row = spikes + trial * trial_stride + first;
            const auto n = size_t(afferents - first < 8 ? afferents - first : 8);
            for (int64_t begin = 0; begin < tally.ends[trial]; begin += 8) {
                uint64_t fired = 0;
                for (int64_t t = begin; t < begin + 8 && t < tally.ends[trial]; t++) {
                    uint64_t eight = 0;
                    std::memcpy(&eight, row + t * time_stride, n);
                    fired |= eight << (t - begin);
                }
                tally.mark_eight_steps(trial, first, fired, begin);
            }
        }
}

void class_sums(const double* rows, const int64_t* labels, int64_t labellings, int64_t trials, int64_t classes, int64_t n,
                double* sums) {
    for (int64_t k = 0; k < labellings; k++)
        for (int64_t trial = 0; trial < trials; trial++) {
            const double* row = rows + trial * n;
            double* sum = sums + (k * classes + labels[k * trials + trial]) * n;
            for (int64_t i = 0; i < n; i++) sum[i] += row[i];
        }
}

void moving_average(const float* __restrict signal, const float* before, float newest, float kept, int64_t trials,
                    int64_t steps, int64_t taxels, float* smooth) {
    for (int64_t trial = 0; trial < trials; trial++) {
        const float* last = before ? before + trial * taxels : signal;
        for (int64_t t = 0; t < steps; t++) {
            for (int64_t i = 0; i < taxels; i++) smooth[i] = newest * signal[i] + kept * last[i];
            last = smooth;
            signal += taxels;
            smooth += taxels;
        }
    }
}

}  // namespace neurotact
