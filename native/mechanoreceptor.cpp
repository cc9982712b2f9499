// Fitted mechanoreceptors, from signals to spikes (encoders/mechanoreceptor.py): each taxel's signal on the clock of the
// fits, then fit by fit filters, currents, noise (encoders/random_numbers.py) and neurons. Operations are those of the
// definition, in its order; logarithms are libm's.
#include <algorithm>
#include <cmath>

#include "dispatch.hpp"
#include "strands.hpp"

namespace neurotact::NT_ISA {
namespace {

constexpr int kLanes = 8;   // taxels side by side
constexpr int kRows = 64;   // fine steps at once
using V = VectorOf<double, kLanes>::type;
using Ints = VectorOf<int64_t, kLanes>::type;
using Words = VectorOf<uint64_t, kLanes>::type;
using S = Simd<double, kLanes>;

// ---- random numbers ------------------------------------------------------------------------------------------------

constexpr uint64_t kGolden = 0x9E3779B97F4A7C15;
constexpr int kBits = 32;

NT_INLINE Words mixed(Words n) {
    n ^= n >> 30;
    n *= 0xBF58476D1CE4E5B9;
    n ^= n >> 27;
    n *= 0x94D049BB133111EB;
    return n ^ n >> 31;
}

// A polynomial, the highest power first; `x` times the first coefficient or, `monic`, plus it.
template <int N>
NT_INLINE V polynomial(V x, const double (&of)[N], bool monic) {
    V sum = monic ? x + of[0] : V{} + of[0];
    for (int i = 1; i < N; i++) sum = sum * x + of[i];
    return sum;
}

// The normal quantiles of numbers in (0, 1), in place: Cephes' ndtri (Moshier), as in SciPy. Below 1.3e-14, which one in
// 4e13 numbers is, that has another polynomial, and these quantiles are 1e-13 off it.
void normal(double* numbers, int n) {
    constexpr double P0[] = {-5.99633501014107895267E1, 9.80010754185999661536E1, -5.66762857469070293439E1,
                             1.39312609387279679503E1, -1.23916583867381258016E0};
    constexpr double Q0[] = {1.95448858338141759834E0, 4.67627912898881538453E0, 8.63602421390890590575E1,
                             -2.25462687854119370527E2, 2.00260212380060660359E2, -8.20372256168333339912E1,
                             1.59056225126211695515E1, -1.18331621121330003142E0};
    constexpr double P1[] = {4.05544892305962419923E0, 3.15251094599893866154E1, 5.71628192246421288162E1,
                             4.40805073893200834700E1, 1.46849561928858024014E1, 2.18663306850790267539E0,
                             -1.40256079171354495875E-1, -3.50424626827848203418E-2, -8.57456785154685413611E-4};
    constexpr double Q1[] = {1.57799883256466749731E1, 4.53907635128879210584E1, 4.13172038254672030440E1,
                             1.50425385692907503408E1, 2.50464946208309415979E0, -1.42182922854787788574E-1,
                             -3.80806407691578277194E-2, -9.33259480895457427372E-4};
    constexpr double edge = 0.13533528323661269189, upper = 1.0 - edge;
    alignas(64) double x[kRows * kLanes], log_x[kRows * kLanes];
    bool above[kRows * kLanes];
    int16_t where[kRows * kLanes + 1];
    int n_far = 0;
    for (int i = 0; i < n; i++) {
        where[n_far] = (int16_t)i;
        n_far += numbers[i] > upper || numbers[i] <= edge;
    }
    for (int i = 0; i < n_far; i++) {
        const double y = numbers[where[i]];
        above[i] = y > upper;
        x[i] = std::sqrt(-2.0 * std::log(above[i] ? 1.0 - y : y));
        log_x[i] = std::log(x[i]);
    }
    for (int i = 0; i < n; i += kLanes) {
        const V y = load<S>(numbers + i) - 0.5, y2 = y * y;
        store(numbers + i, (y + y * (y2 * polynomial(y2, P0, false) / polynomial(y2, Q0, true))) * 2.50662827463100050242);
    }
    for (int i = n_far; i % kLanes; i++) x[i] = log_x[i] = 1.0;
    for (int i = 0; i < n_far; i += kLanes) {
        const V far = load<S>(x + i), z = 1.0 / far;
        store(x + i, (far - load<S>(log_x + i) / far) - z * polynomial(z, P1, false) / polynomial(z, Q1, true));
    }
    for (int i = 0; i < n_far; i++) numbers[where[i]] = above[i] ? x[i] : -x[i];
}

// ---- afferents -----------------------------------------------------------------------------------------------------

// A low pass of order 3 and its last value (scipy.signal.lfilter).
struct LowPass {
    V z[3], last;
    NT_INLINE V step(const MechanoreceptorFit& fit, V x) {
        const V y = z[0] + fit.b[0] * x;
        z[0] = z[1] + x * fit.b[1] - y * fit.a[1];
        z[1] = z[2] + x * fit.b[2] - y * fit.a[2];
        z[2] = x * fit.b[3] - y * fit.a[3];
        return y;
    }
};

struct Kept {
    LowPass rate, depth;
    V membrane, since;
};
static_assert(sizeof(Kept) == kMechanoreceptorState * sizeof(V));

NT_INLINE V two_sided(V drive, double up, double down) { return drive * (drive >= 0 ? V{} + up : V{} - down); }

// One fit under a vector of taxels for some fine steps.
void run_fit(const MechanoreceptorFit& fit, const double* post_spike, int64_t post_spike_steps, int64_t longest_since,
             const V* depth, const V* noise, int n, Kept& state, uint8_t* fired, int64_t fired_stride) {
    Kept now = state;
    Ints since = __builtin_convertvector(now.since, Ints);
    const bool accelerates = fit.acceleration_up || fit.acceleration_down, presses = fit.static_up || fit.static_down;
    const Ints longest = Ints{} + longest_since, least = Ints{} + (int64_t)fit.least_steps;
    for (int k = 0; k < n; k++) {
        const V rate = now.rate.last;
        V current = two_sided(rate, fit.velocity_up, fit.velocity_down);
        now.rate.last = now.rate.step(fit, (depth[k + 2] - depth[k]) * fit.by_rate);
        if (accelerates) current += two_sided(now.rate.last - rate, fit.acceleration_up, fit.acceleration_down);
        if (presses) {
            current += two_sided(now.depth.last, fit.static_up, fit.static_down);
            now.depth.last = now.depth.step(fit, depth[k + 1] * fit.by_depth);
        }
        if (fit.saturation > 0) current = fit.saturation * current / (fit.saturation + magnitude<S>(current));
        if (noise) current += fit.noise * noise[k];
        const Ints at = since < post_spike_steps ? since : Ints{} + post_spike_steps;
        const V after = {post_spike[at[0]], post_spike[at[1]], post_spike[at[2]], post_spike[at[3]],
                         post_spike[at[4]], post_spike[at[5]], post_spike[at[6]], post_spike[at[7]]};
        now.membrane = now.membrane - now.membrane / fit.tau_steps + current + after;
        since = since < longest ? since + 1 : longest;
        const Ints spikes = (now.membrane > 1.0) & (since >= least);
        now.membrane = spikes ? V{} : now.membrane;
        since = spikes ? Ints{} : since;
        store_bytes<kLanes>(fired + k * fired_stride, spikes);
    }
    now.since = __builtin_convertvector(since, V);
    state = now;
}

// All fits under a vector of taxels.
template <class T>
void run(const Mechanoreceptors<T>& e, const Strand& strand) {
    using Few = typename VectorOf<T, kLanes>::type;
    using Floats = VectorOf<float, kLanes>::type;
    using Bits = VectorOf<uint32_t, kLanes>::type;
    const int pitch = e.signals.pitch;
    const int64_t row = (int64_t)e.copies * pitch;
    const T* signal = e.signals.data + strand.in(e.signals.steps, pitch);
    double *last = e.last + strand.in(1, pitch), *before = e.before + strand.in(2, pitch);
    uint8_t* fired = e.fired + strand.trial * (e.under_way + e.n_fine) * row + strand.lane;
    uint8_t* spikes = e.signals.spikes + strand.trial * e.signals.steps * row + strand.lane;
    double* kept = e.kept + strand.trial * kMechanoreceptorState * row + strand.lane;
    const auto sample = [&](int64_t t) {
        Few found;
        std::memcpy(&found, signal + t * pitch, sizeof found);
        return __builtin_convertvector(found, V);
    };
    Words digest;
    std::memcpy(&digest, e.digest + strand.in(1, pitch), sizeof digest);
    int64_t heard = 0;  // samples in the digest
    const auto hear = [&](int64_t until) {
        for (; heard < until; heard++) {
            const Floats value = __builtin_convertvector(sample(heard), Floats) + 0.0f;  // -0 is 0
            const Words step = Words{} + ((uint64_t)(e.first_step + heard) << kBits);
            digest += mixed(__builtin_convertvector((Bits)value, Words) | step);
        }
    };
    V depth[kRows + 2] = {load<S>(before), load<S>(before + pitch)}, noise[kRows];
    Words key[kRows];
    for (int64_t first = 0; first < e.n_fine; first += kRows) {
        const int n = (int)std::min<int64_t>(kRows, e.n_fine - first);
        for (int k = 0; k < n; k++) {
            const int64_t t = e.step_of[first + k];
            hear(t + 1);
            const V low = t ? sample(t - 1) : load<S>(last);
            depth[k + 2] = low + e.share[first + k] * (sample(t) - low);
            key[k] = digest + (uint64_t)(e.first_fine + first + k) * kGolden;
        }
        for (int copy = 0; copy < e.copies; copy++) {
            const MechanoreceptorFit& fit = e.fits[copy];
            if (e.places) {
                Words place;
                std::memcpy(&place, e.places + copy * pitch + strand.lane, sizeof place);
                for (int k = 0; k < n; k++)
                    noise[k] = (__builtin_convertvector(mixed(key[k] + place) >> 11, V) + 0.5) * 0x1p-53;
                normal(reinterpret_cast<double*>(noise), n * kLanes);
            }
            V state[kMechanoreceptorState];
            double* mine = kept + copy * kMechanoreceptorState * pitch;
            for (int i = 0; i < kMechanoreceptorState; i++) state[i] = load<S>(mine + i * pitch);
            Kept now;
            std::memcpy(&now, state, sizeof now);
            run_fit(fit, e.post_spike + copy * (e.post_spike_steps + 1), e.post_spike_steps, e.longest_since, depth,
                    e.places ? noise : nullptr, n, now, fired + (e.under_way + first) * row + copy * pitch, row);
            std::memcpy(state, &now, sizeof now);
            for (int i = 0; i < kMechanoreceptorState; i++) store(mine + i * pitch, state[i]);
            const uint8_t* arrived = fired + (first + e.under_way - (int64_t)fit.delay) * row + copy * pitch;
            for (int k = 0; k < n; k++) {
                uint64_t more, eight;
                uint8_t* to = spikes + e.step_of[first + k] * row + copy * pitch;
                std::memcpy(&more, arrived + k * row, kLanes);
                std::memcpy(&eight, to, kLanes);
                eight |= more;
                std::memcpy(to, &eight, kLanes);
            }
        }
        depth[0] = depth[n];
        depth[1] = depth[n + 1];
    }
    hear(e.signals.steps);
    std::memcpy(e.digest + strand.in(1, pitch), &digest, sizeof digest);
    for (int i = 0; i < 2; i++) store(before + i * pitch, depth[i]);
    if (e.signals.steps) store(last, sample(e.signals.steps - 1));
}

}  // namespace

template <class T>
void mechanoreceptors(const Mechanoreceptors<T>& e) {
    each_strand<1, kLanes>(e.signals, [&](const Strand* strand, auto) { run(e, *strand); });
}

template void mechanoreceptors<NT_REAL>(const Mechanoreceptors<NT_REAL>&);

}  // namespace neurotact::NT_ISA
