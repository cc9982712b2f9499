// Vectors of taxels, some side by side: a step waits for the one before it, and another vector's fills the gap.
#pragma once
#include "parallel.h"

#include <type_traits>

#include "kernels.hpp"
#include "simd.hpp"

namespace neurotact::NT_ISA {

// Where a vector of L taxels lies: its trial, and its first taxel there.
struct Strand {
    int64_t trial;
    int lane;
    Strand() = default;
    Strand(int64_t number, int pitch, int lanes)
        : trial(number / (pitch / lanes)), lane(int(number % (pitch / lanes)) * lanes) {}
    // In an array (trial, row, pitch).
    int64_t in(int64_t rows, int pitch) const { return trial * rows * pitch + lane; }
};

// Calls `run(strands, N)` for all vectors of L taxels; N, the number of strands, is a compile-time constant.
template <int N, int L, class T, class Run>
void each_strand(const Signals<T>& s, const Run& run) {
    const int64_t n = s.trials * (s.pitch / L), groups = (n + N - 1) / N;
#pragma omp parallel for num_threads(s.threads) schedule(dynamic)
    for (int64_t group = 0; group < groups; group++) {
        int64_t first = group * N;
        Strand strands[N];
        for (int i = 0; i < N; i++) strands[i] = Strand(first + i, s.pitch, L);
        if (first + N <= n) {
            run(strands, std::integral_constant<int, N>());
        } else {
            for (int i = 0; first + i < n; i++) run(strands + i, std::integral_constant<int, 1>());
        }
    }
}

// A byte of 0 or 1 for each lane.
template <int L, class Bits>
NT_INLINE void store_bytes(uint8_t* to, Bits mask) {
    const auto ones = __builtin_convertvector(mask & 1, typename VectorOf<uint8_t, L>::type);
    std::memcpy(to, &ones, L);
}

}  // namespace neurotact::NT_ISA
