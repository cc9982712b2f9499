// What the kernels take: plain structures of sizes and addresses, the same for every instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

namespace neurotact {

enum class Membrane : int { eq4, delayed, immediate };
enum class Reset : int { zero, subtract, hard };
struct Neuron {
    Membrane membrane;
    Reset reset;
    int recurrent_delay;  // d of the recurrent input V s[t-d] to I[t+1]: 0 or 1
    // Whether step t emits s[t+1], and not s[t].
    constexpr bool emits_at_once() const { return membrane == Membrane::immediate; }
};

// Spikes (trial, time, neuron) where the caller keeps them; neighbouring neurons lie side by side.
struct SpikesIn {
    enum Kind : int { byte = 1, real32 = 4, real64 = 8 };
    const void* data;
    Kind kind;
    int64_t trial_stride, time_stride;  // in elements
};

struct Sizes {
    int64_t trials, steps;
    int inputs, hidden, classes;  // classes = 0: a single layer
};

// alpha, beta and threshold of one layer: one value for all its neurons (stride 0) or one each (stride 1).
template <class T>
struct Dynamics {
    const T *alpha, *beta, *threshold;
    int stride;
    T scale;  // lambda of the surrogate
};

// Thresholds that adapt: A[t+1] = decay A[t] + s[t], and U[t] - strength A[t] is what is compared with the threshold; see
// neurons.py, Adaptation.
template <class T>
struct Adaptation {
    bool on;
    T strength, decay;
};

// A readout that does not spike: y[t+1] = decay y[t] + W s[t]; see neurotact/networks/definition/readouts.py. Where it
// leaks, or takes the largest value over time, the network's own passes know it; a plain sum follows from the hidden
// layer's counts.
// A window may be divided into stretches, each with its own w_out, one after the other; the last one has no end.
struct Integration {
    bool leaks, peak;  // peak: leaks too
    double decay;
    int64_t stretches = 1, stretch_steps = 1;
    bool direct = false;  // w_out has rows for the afferents, too, behind those of the hidden neurons
    constexpr int64_t stretch_of(int64_t step) const {
        const int64_t k = stretches > 1 ? step / stretch_steps : 0;
        return k < stretches ? k : stretches - 1;
    }
    // Whether a stretch, and not the window, ends with this step.
    constexpr bool ends(int64_t step) const { return stretches > 1 && stretch_of(step) != stretch_of(step + 1); }
};

// A network: one layer, recurrent where w_rec is given, and a readout where classes > 0.
// Weights lie (presynaptic, postsynaptic), without gaps.
template <class T>
struct Net {
    Sizes sizes;
    SpikesIn spikes;
    Neuron neuron;
    const T *w_in, *w_rec, *w_out;
    Dynamics<T> hidden, readout;
    Adaptation<T> adaptation;  // of the hidden layer
    const double* bias;  // (class) of an integrator, which adds up w_out of every spike that it hears; else null
    Integration integration;
    int threads;
};

// Sums over the window, or the window itself; null where not wanted.
template <class T>
struct Outputs {
    T* readout;  // (trial, class) counts, or the values of an integrator that leaks, without its bias
    T* hidden;   // (trial, hidden) counts, or of each stretch (trial, stretch, hidden)
    T* raster;   // (trial, time, hidden) of 0 and 1
    uint64_t* spikes = nullptr;  // of the register kernel: s[t+1] of the pair of trials at hand, (trial, time)
};

// dL/d(output) in, dL/d(parameter) out; null where not given or not wanted.
template <class T>
struct Gradients {
    const T *readout, *hidden, *raster;
    T *w_in, *w_rec, *w_out;
    T* spikes;    // (trial, time, input)
    T* dynamics;  // alpha, beta, threshold of every hidden neuron, then of every readout neuron
};

// What training remembers of the forward pass, trial after trial, step after step (see tape_bytes). Row t holds
// U[t+1], I[t+1] and s[t+1]; of a layer whose thresholds adapt U[t+1] - k A[t+1], which is all that its gradients ask for.
template <class T>
struct Tape {
    T *membrane, *readout_membrane;  // (trial, time, pitch)
    T *current, *readout_current;    // the same, only where alpha or beta is learned
    T* raised;                       // k A[t+1] of the hidden layer, only where it adapts and these are learned
    uint64_t *inputs, *spikes;       // (trial, time, words)
    T* taken;                        // (trial, pitch) steps after which a leaky readout has its value; it has no membranes
};

constexpr int kPitch = 16;  // of which the neurons of a layer in memory are a multiple: whole vectors of any kind

// How a network is laid out: neurons padded to whole vectors.
struct Layout {
    int hidden_pitch, readout_pitch;
    bool small;  // the register kernel of small_net.cpp; else wide_net.cpp
};
// Each form of the register kernel is compiled for every instruction set. So it takes thresholds that adapt in float32
// alone, beside so many readout neurons, and for these, as for more than 16 readout neurons, it knows fewer widths.
constexpr int kAdaptingReadout = 16, kRarePitch = 32;

// `wants_more`: what a caller wants of a network that the register kernel does not do: the window itself, dL/d(input), or
// dynamics of every neuron's own.
Layout layout_of(const Sizes& sizes, const Neuron& neuron, bool is_double, bool adapts, bool wants_more);

// Exit when the leading class has stood for more than `patience` steps; negative: never. Of a smaller lead than
// `least_lead`, a stream decides that it is none of the classes.
struct ExitRule {
    int64_t patience;
    bool from_first_spike;
    double least_lead = 0;
};

// A row a trial; see neurotact/networks/definition/network.py, Inference.
struct Decisions {
    int64_t *labels, *steps, *input_spikes, *hidden_spikes;
    int64_t* counts;  // (trial, class), of a readout that spikes
    double* sums;     // the same, values of an integrator
};

// A population of afferent LIF neurons driven by conditioned signals; see encoders/afferents.py.
template <class T>
struct Encoding {
    int64_t trials, steps;
    int taxels;
    const T* signal;                            // (trial, time, taxel), neighbouring taxels side by side
    int64_t trial_stride, time_stride;          // in elements
    T sa_gain, ra_gain;                         // mV per unit; mV per (unit per step)
    T decay, v_rest, v_reset, v_threshold;
    int32_t sa_silent, ra_silent;               // refractory steps
    T *sa_membrane, *ra_membrane, *last;        // state in and out, (trial, taxel)
    int32_t *sa_silent_left, *ra_silent_left;   // likewise
    bool has_last;                              // false: the first derivative is 0
    uint8_t* spikes;                            // (trial, time, 2 taxel)
    int threads;
};

// What a search for gains asks of spikes in place of a raster: how many intervals between the spikes of an afferent fall
// into each bin; see neurotact/encoders/tally.py. Rows are those of a trial, of `pitch` afferents.
struct Tally {
    const int32_t* bin_of;  // of an interval in steps
    int64_t bins, floor;    // floor: the longest interval that counts as at the refractory floor
    const int64_t* ends;    // (trial): the first step that does not count
    int64_t pitch;
    int32_t *last, *intervals;  // (trial, afferent): step of the last spike, -1 before; (trial, afferent, bin)
    int64_t* at_floor;          // (trial)

    // The spikes of an afferent come in order.
    void mark(int64_t trial, int64_t afferent, int64_t step) const {
        const int64_t row = trial * pitch + afferent;
        const int64_t isi = step - last[row];
        if (last[row] >= 0) {
            intervals[row * bins + bin_of[isi]]++;
            at_floor[trial] += isi <= floor;
        }
        last[row] = int32_t(step);
    }
    // Eight neighbours from `first` on at eight steps from `begin` on: a byte of `fired` for each, a bit for each step. One
    // loop over all of them, as a branch at each step is rarely foreseen.
    void mark_eight_steps(int64_t trial, int64_t first, uint64_t fired, int64_t begin) const {
        const int64_t left = ends[trial] - begin;
        if (left < 8) fired &= left <= 0 ? 0 : (0xffu >> (8 - left)) * 0x0101010101010101u;
        int32_t* const last_step = last + trial * pitch + first;
        int32_t* const counts = intervals + (trial * pitch + first) * bins;
        int64_t n_at_floor = 0;
        for (; fired; fired &= fired - 1) {
            const int at = __builtin_ctzll(fired), afferent = at / 8;
            const int32_t step = int32_t(begin) + at % 8, isi = step - last_step[afferent];
            if (last_step[afferent] >= 0) {
                counts[afferent * bins + bin_of[isi]]++;
                n_at_floor += isi <= floor;
            }
            last_step[afferent] = step;
        }
        at_floor[trial] += n_at_floor;
    }
};

// A population of afferent LIF neurons whose spikes are tallied.
template <class T>
struct TalliedPopulation {
    int64_t trials, steps;
    int taxels;     // a multiple of kLanes
    const T* felt;  // (trial, time, taxel), which times the gain is the drive in mV
    T gain, decay, v_rest, v_reset, v_threshold;
    int32_t silent;  // refractory steps
    Tally tally;
    int threads;
};

// Afferent LIF neurons in closed form, once per sample; see neurotact/encoders/closed_form.py.
template <class T>
struct ExactEncoding {
    int64_t trials, samples, steps;  // steps: rows of a trial's spikes; the first is step `first_step` of the trial
    int afferents;
    const T* drive;          // mV, (trial, sample, afferent)
    const double* t_ref_ms;  // (afferent)
    double tau_ms, v_rest, v_reset, v_threshold;
    double sample_ms, steps_per_ms, steps_per_sample;
    int64_t samples_before, first_step;
    double *membrane, *refractory_ms;  // state in and out, (trial, afferent)
    uint8_t* spikes;                   // (trial, step, afferent), where ones are added
    int threads;
    const Tally* tally = nullptr;      // in place of spikes
};

// Conditioned signals of the encoders beside the core: the taxels lie in rows padded to whole vectors.
template <class T>
struct Signals {
    int64_t trials, steps;
    int pitch;
    const T* data;    // (trial, step, pitch)
    uint8_t* spikes;  // (trial, step, population, pitch)
    int threads;
};

// See encoders/izhikevich.py. State in and out: `last` (trial, pitch), `membrane` and `recovery` (trial, 2, pitch).
template <class T>
struct Izhikevich {
    Signals<T> signals;
    T sa_gain, ra_gain, step_ms, recovers, b, c, d, peak;  // recovers: a times the Euler step
    int euler_steps;
    bool has_last;
    T *last, *membrane, *recovery;
};

// See encoders/bens_spiker.py. State in and out: `remaining` (trial, tap, 2, pitch).
template <class T>
struct BensSpiker {
    Signals<T> signals;
    T gain, threshold;
    int n_taps;
    const T* taps;
    T* remaining;
};

// See encoders/mechanoreceptor.py, `_Copy.constants`.
struct MechanoreceptorFit {
    double by_depth, by_rate;  // a drive for each mm, and for each change in two steps
    double b[4], a[4];         // the low pass
    double static_up, static_down, velocity_up, velocity_down, acceleration_up, acceleration_down;
    double saturation, noise, tau_steps, least_steps, delay;
};

// What a fit keeps between steps, (value, pitch), as in encoders/mechanoreceptor.py, `_kept`.
constexpr int kMechanoreceptorState = 10;

template <class T>
struct Mechanoreceptors {
    Signals<T> signals;
    int64_t first_step, first_fine, n_fine;  // numbers of the first step and of the first on the clock of the fits
    const int64_t* step_of;                  // (fine) from the first step on
    const double* share;                     // (fine) of the way from the sample before to that of the step
    int copies;
    const MechanoreceptorFit* fits;  // (copy)
    const double* post_spike;        // (copy, post_spike_steps + 1)
    int64_t post_spike_steps, longest_since;
    const uint64_t* places;  // (copy, pitch) of random numbers; null: no noise
    double *last, *before;   // state in and out, (trial, pitch) and (trial, 2, pitch)
    uint64_t* digest;        // (trial, pitch)
    double* kept;            // (trial, copy, kMechanoreceptorState, pitch)
    int64_t under_way;       // rows of `fired` before the first fine step
    uint8_t* fired;          // (trial, under_way + fine, copy, pitch)
};

void tally_raster(const uint8_t* spikes, int64_t trials, int64_t trial_stride, int64_t time_stride, int64_t afferents,
                  const Tally& tally);
// Adds the rows (trial, n) of each class to its sum, (labelling, class, n), trial by trial.
void class_sums(const double* rows, const int64_t* labels, int64_t labellings, int64_t trials, int64_t classes, int64_t n,
                double* sums);

// Exponential moving average over time of signals (trial, step, taxel): `newest` of a step and `kept` of the average before,
// which is `before` (trial, taxel) at the first step; null: the first step itself.
void moving_average(const float* signal, const float* before, float newest, float kept, int64_t trials, int64_t steps,
                    int64_t taxels, float* smooth);

enum class Baseline : int { none, first, start, running, high_pass };

// Where a stream writes down what spiked in each step of a push: a row of words a step, as in spikes.hpp. `window` is the
// oldest one that heard the step, -1 where none did; `hidden` is what its hidden layer sent to the readout.
struct StreamTrace {
    uint64_t *afferents, *hidden;
    int64_t* window;
    int64_t room, first, steps;  // steps that there is room for; the first that was written down, and how many
};

// A chain that takes samples as they come: conditioning, afferents, windows, network, exit (streams/stream.py).
struct StreamPlan {
    int taxels;
    float factor;                        // by which samples are multiplied first
    bool smooth, resampled, rectify;
    float smooth_new, smooth_kept;       // of the moving average
    double samples_per_step;
    Baseline baseline;
    int64_t start_steps;                 // of the baseline `start`
    float base_new, base_kept;           // of the baseline `high_pass`
    const float *offset, *scale;         // (taxel), null where there are none
    float decay, v_rest, v_reset, v_threshold;
    int32_t sa_silent, ra_silent;
    const float* gains;                  // of the afferents under a taxel: SA-I (below 0: of the falling signal), RA-I
    int n_slow, n_rapid;                 // their numbers
    const int32_t* numbers;              // (gain, taxel): the afferent's, -1 for none; null: all are there, in this order
    int64_t length, start, hop, quiet;   // of windows, in steps; hop 0: at a contact
    int64_t bin;                         // steps of the encoder's clock in one of the network's
    int at_once;                         // windows that overlap at most
    ExitRule rule;
    Net<float> net;
    StreamTrace* trace = nullptr;        // null: nothing is written down
    const float* fans = nullptr;         // synapses of each afferent, then of each hidden neuron; null: all exist
};

// What was decided of a window; see streams/stream.py, Decision.
struct Decided {
    int64_t window, start, steps, label, input_spikes, hidden_spikes, held, heard, sops;  // sops: where `fans` are given
};

// Called with each part of a stream's state, in the order of its type (streams/native.py).
struct Visitor {
    void* to;
    void (*visit)(void* to, void* at, size_t bytes);
};

// At most so many partial sums of gradients.
constexpr int kWideGroups = 16, kSmallGroups = 64;

constexpr int64_t words(int neurons) { return (neurons + 63) / 64; }
constexpr int round_up(int n, int multiple) { return (n + multiple - 1) / multiple * multiple; }

}  // namespace neurotact
