// The Python module. Tensors and arrays come as addresses, by name: the Python side has checked their shapes and types,
// and handing over a dozen of them as objects would cost more than a small kernel.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dispatch.hpp"
#include "memory.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace neurotact;

namespace {

using Address = uintptr_t;

template <class T>
T* at(Address address) {
    return reinterpret_cast<T*>(address);
}

// The part of a call that does not change from one to the next. Python makes one for each shape of a network and keeps it.
struct Shape {
    Sizes sizes;
    Neuron neuron;
    double scale, readout_scale, adaptation, adaptation_decay;
    bool is_double, recurrent, per_neuron, keep_currents;
    Layout layout;
    Integration integration;
};

// Calls `run` with a value of the float type of the shape.
template <class Run>
auto with_real(const Shape& shape, const Run& run) {
    return shape.is_double ? run(double{}) : run(float{});
}

template <class T>
Tape<T> cut_tape(const Shape& shape, int64_t trials, int64_t steps, Carver& carver) {
    const int64_t rows = (trials + trials % 2) * steps;  // small_net.cpp runs trials in pairs
    const int64_t hidden = rows * shape.layout.hidden_pitch, readout = rows * shape.layout.readout_pitch;
    Tape<T> tape{};
    tape.membrane = carver.take<T>(hidden);
    const bool leaks = shape.integration.leaks;
    tape.readout_membrane = leaks ? nullptr : carver.take<T>(readout);
    tape.current = shape.keep_currents ? carver.take<T>(hidden) : nullptr;
    tape.readout_current = shape.keep_currents && !leaks ? carver.take<T>(readout) : nullptr;
    tape.raised = shape.keep_currents && shape.adaptation > 0 ? carver.take<T>(hidden) : nullptr;
    tape.taken = leaks ? carver.take<T>((trials + trials % 2) * shape.layout.readout_pitch) : nullptr;
    tape.inputs = carver.take<uint64_t>(rows * words(shape.sizes.inputs));
    tape.spikes = carver.take<uint64_t>(rows * words(shape.sizes.hidden));
    return tape;
}

size_t tape_bytes(const Shape& shape, int64_t trials, int64_t steps) {
    return with_real(shape, [&](auto real) {
        Carver carver;
        cut_tape<decltype(real)>(shape, trials, steps, carver);
        return carver.bytes();
    });
}

// A block of the pool that Python holds as a tensor, so that autograd frees it with what else it has saved.
nb::ndarray<nb::pytorch, uint8_t, nb::ndim<1>> new_tape(const Shape& shape, int64_t trials, int64_t steps) {
    const size_t bytes = tape_bytes(shape, trials, steps);
    auto* block = new Block(bytes);
    nb::capsule owner(block, [](void* p) noexcept { delete static_cast<Block*>(p); });
    return {block->data(), {bytes}, owner};
}

struct Parameters {
    Address w_in, w_rec, w_out, alpha, beta, threshold;
};

template <class T>
Net<T> make_net(const Shape& shape, int64_t trials, int64_t steps, const SpikesIn& spikes, const Parameters& of,
                Address bias, int threads) {
    Sizes sizes = shape.sizes;
    sizes.trials = trials;
    sizes.steps = steps;
    // A fused network has two values of each: the hidden layer's and the readout's.
    const int stride = shape.per_neuron ? 1 : 0;
    const Dynamics<T> hidden{at<const T>(of.alpha), at<const T>(of.beta), at<const T>(of.threshold), stride,
                             T(shape.scale)};
    const Dynamics<T> readout{hidden.alpha + 1, hidden.beta + 1, hidden.threshold + 1, stride, T(shape.readout_scale)};
    return {sizes, spikes, shape.neuron, at<const T>(of.w_in), shape.recurrent ? at<const T>(of.w_rec) : nullptr,
            sizes.classes ? at<const T>(of.w_out) : nullptr, hidden, readout,
            {shape.adaptation > 0, T(shape.adaptation), T(shape.adaptation_decay)}, at<const double>(bias),
            shape.integration, threads};
}

// What every call takes: windows, weights and dynamics, by name and no other way, since a swap of two addresses would
// be a corruption of memory.
#define NT_WINDOW int64_t trials, int64_t steps
#define NT_SPIKES Address spikes, int spike_kind, int64_t trial_stride, int64_t time_stride
#define NT_PARAMETERS Address w_in, Address w_rec, Address w_out, Address alpha, Address beta, Address threshold
#define NT_WINDOW_NAMES "shape"_a, nb::kw_only(), "trials"_a, "steps"_a
#define NT_SPIKES_NAMES "spikes"_a, "spike_kind"_a, "trial_stride"_a, "time_stride"_a
#define NT_PARAMETERS_NAMES "w_in"_a, "w_rec"_a, "w_out"_a, "alpha"_a, "beta"_a, "threshold"_a

void add_network(nb::module_& m) {
    m.def("make_shape",
          [](int inputs, int hidden, int classes, int membrane, int reset, int recurrent_delay, double adaptation,
             double adaptation_decay, double scale, double readout_scale, bool is_double, bool recurrent, bool per_neuron, bool keep_currents, bool with_inputs,
             bool with_raster, bool leaks, bool peak, double decay, int64_t stretches, int64_t stretch_steps,
             bool direct) -> Shape {
              const Sizes sizes{0, 0, inputs, hidden, classes};
              const Neuron neuron{Membrane(membrane), Reset(reset), recurrent_delay};
              const Layout layout = layout_of(sizes, neuron, is_double, adaptation > 0,
                                               with_inputs || with_raster || per_neuron);
              return {sizes, neuron, scale, readout_scale, adaptation, adaptation_decay, is_double, recurrent,
                      per_neuron, keep_currents, layout, {leaks, peak, decay, stretches, stretch_steps, direct}};
          },
          nb::kw_only(), "inputs"_a, "hidden"_a, "classes"_a, "membrane"_a, "reset"_a, "recurrent_delay"_a,
          "adaptation"_a, "adaptation_decay"_a, "scale"_a, "readout_scale"_a, "is_double"_a, "recurrent"_a, "per_neuron"_a, "keep_currents"_a, "with_inputs"_a,
          "with_raster"_a, "leaks"_a, "peak"_a, "decay"_a, "stretches"_a = 1, "stretch_steps"_a = 1, "direct"_a = false);
    m.def("tape_bytes", &tape_bytes, NT_WINDOW_NAMES);
    m.def("new_tape", &new_tape, NT_WINDOW_NAMES);
    m.def("forward",
          [](const Shape& shape, NT_WINDOW, NT_SPIKES, NT_PARAMETERS, Address tape, Address readout, Address hidden,
             Address raster, int threads) {
              nb::gil_scoped_release release;
              const SpikesIn in{at<const void>(spikes), SpikesIn::Kind(spike_kind), trial_stride, time_stride};
              const Parameters of{w_in, w_rec, w_out, alpha, beta, threshold};
              return with_real(shape, [&](auto real) {
                  using T = decltype(real);
                  Carver carver(at<char>(tape));
                  const Tape<T> cut = cut_tape<T>(shape, trials, steps, carver);
                  const auto run = shape.layout.small ? kernels<T>().small_forward : kernels<T>().wide_forward;
                  return run(make_net<T>(shape, trials, steps, in, of, 0, threads), shape.layout,
                             {at<T>(readout), at<T>(hidden), at<T>(raster)}, tape ? &cut : nullptr);
              });
          },
          NT_WINDOW_NAMES, NT_SPIKES_NAMES, NT_PARAMETERS_NAMES, "tape"_a, "readout"_a, "hidden"_a, "raster"_a,
          "threads"_a);
    m.def("backward",
          [](const Shape& shape, NT_WINDOW, NT_PARAMETERS, Address tape, Address g_readout, Address g_hidden,
             Address g_raster, Address g_w_in, Address g_w_rec, Address g_w_out, Address g_spikes, Address g_dynamics,
             int threads) {
              nb::gil_scoped_release release;
              const Parameters of{w_in, w_rec, w_out, alpha, beta, threshold};
              with_real(shape, [&](auto real) {
                  using T = decltype(real);
                  Carver carver(at<char>(tape));
                  const Tape<T> cut = cut_tape<T>(shape, trials, steps, carver);
                  const auto run = shape.layout.small ? kernels<T>().small_backward : kernels<T>().wide_backward;
                  run(make_net<T>(shape, trials, steps, {}, of, 0, threads), shape.layout, cut,
                      {at<const T>(g_readout), at<const T>(g_hidden), at<const T>(g_raster), at<T>(g_w_in),
                       at<T>(g_w_rec), at<T>(g_w_out), at<T>(g_spikes), at<T>(g_dynamics)});
              });
          },
          NT_WINDOW_NAMES, NT_PARAMETERS_NAMES, "tape"_a, "g_readout"_a, "g_hidden"_a, "g_raster"_a, "g_w_in"_a,
          "g_w_rec"_a, "g_w_out"_a, "g_spikes"_a, "g_dynamics"_a, "threads"_a);
    m.def("infer",
          [](const Shape& shape, NT_WINDOW, NT_SPIKES, NT_PARAMETERS, Address bias, int64_t patience,
             bool from_first_spike, Address labels, Address steps_run, Address input_spikes, Address hidden_spikes,
             Address counts, Address sums, int threads) {
              nb::gil_scoped_release release;
              const SpikesIn in{at<const void>(spikes), SpikesIn::Kind(spike_kind), trial_stride, time_stride};
              const Parameters of{w_in, w_rec, w_out, alpha, beta, threshold};
              const Decisions to{at<int64_t>(labels),        at<int64_t>(steps_run), at<int64_t>(input_spikes),
                                 at<int64_t>(hidden_spikes), at<int64_t>(counts),    at<double>(sums)};
              return with_real(shape, [&](auto real) {
                  using T = decltype(real);
                  const Net<T> net = make_net<T>(shape, trials, steps, in, of, bias, threads);
                  if (shape.layout.small && shape.sizes.hidden > 0 && patience < 0)
                      return kernels<T>().small_infer(net, shape.layout, to);
                  return kernels<T>().infer(net, {patience, from_first_spike}, to);
              });
          },
          NT_WINDOW_NAMES, NT_SPIKES_NAMES, NT_PARAMETERS_NAMES, "bias"_a, "patience"_a, "from_first_spike"_a,
          "labels"_a, "steps_run"_a, "input_spikes"_a, "hidden_spikes"_a, "counts"_a, "sums"_a, "threads"_a);
}

template <class T>
void encode_as(int64_t trials, int64_t steps, int taxels, Address signal, int64_t trial_stride, int64_t time_stride,
               double sa_gain, double ra_gain, double decay, double v_rest, double v_reset, double v_threshold,
               int sa_silent, int ra_silent, Address sa_membrane, Address ra_membrane, Address last,
               Address sa_silent_left, Address ra_silent_left, bool has_last, Address spikes, int threads) {
    const Encoding<T> encoding{trials, steps, taxels, at<const T>(signal), trial_stride, time_stride,
                               T(sa_gain), T(ra_gain), T(decay), T(v_rest), T(v_reset), T(v_threshold),
                               sa_silent, ra_silent, at<T>(sa_membrane), at<T>(ra_membrane), at<T>(last),
                               at<int32_t>(sa_silent_left), at<int32_t>(ra_silent_left), has_last, at<uint8_t>(spikes), threads};
    kernels<T>().encode(encoding);
}

void encode(bool is_double, int64_t trials, int64_t steps, int taxels, Address signal, int64_t trial_stride,
            int64_t time_stride, double sa_gain, double ra_gain, double decay, double v_rest, double v_reset,
            double v_threshold, int sa_silent, int ra_silent, Address sa_membrane, Address ra_membrane, Address last,
            Address sa_silent_left, Address ra_silent_left, bool has_last, Address spikes, int threads) {
    nb::gil_scoped_release release;
    const auto run = is_double ? encode_as<double> : encode_as<float>;
    run(trials, steps, taxels, signal, trial_stride, time_stride, sa_gain, ra_gain, decay, v_rest, v_reset, v_threshold,
        sa_silent, ra_silent, sa_membrane, ra_membrane, last, sa_silent_left, ra_silent_left, has_last, spikes, threads);
}

template <class T>
void encode_exact_as(int64_t trials, int64_t samples, int64_t steps, int afferents, Address drive, Address t_ref_ms,
                     double tau_ms, double v_rest, double v_reset, double v_threshold, double sample_ms,
                     double steps_per_ms, double steps_per_sample, int64_t samples_before, int64_t first_step,
                     Address membrane, Address refractory_ms, Address spikes, int threads) {
    kernels<T>().encode_exact({trials, samples, steps, afferents, at<const T>(drive), at<const double>(t_ref_ms), tau_ms,
                               v_rest, v_reset, v_threshold, sample_ms, steps_per_ms, steps_per_sample, samples_before,
                               first_step, at<double>(membrane), at<double>(refractory_ms), at<uint8_t>(spikes), threads});
}

void add_exact(nb::module_& m) {
    m.def("encode_exact",
          [](bool is_double, int64_t trials, int64_t samples, int64_t steps, int afferents, Address drive,
             Address t_ref_ms, double tau_ms, double v_rest, double v_reset, double v_threshold, double sample_ms,
             double steps_per_ms, double steps_per_sample, int64_t samples_before, int64_t first_step, Address membrane,
             Address refractory_ms, Address spikes, int threads) {
              nb::gil_scoped_release release;
              const auto run = is_double ? encode_exact_as<double> : encode_exact_as<float>;
              run(trials, samples, steps, afferents, drive, t_ref_ms, tau_ms, v_rest, v_reset, v_threshold, sample_ms,
                  steps_per_ms, steps_per_sample, samples_before, first_step, membrane, refractory_ms, spikes, threads);
          },
          nb::kw_only(), "is_double"_a, "trials"_a, "samples"_a, "steps"_a, "afferents"_a, "drive"_a, "t_ref_ms"_a,
          "tau_ms"_a, "v_rest"_a, "v_reset"_a, "v_threshold"_a, "sample_ms"_a, "steps_per_ms"_a, "steps_per_sample"_a,
          "samples_before"_a, "first_step"_a, "membrane"_a, "refractory_ms"_a, "spikes"_a, "threads"_a);
}

// Signals and their spikes, as each encoder beside the core takes them.
#define NT_SIGNALS bool is_double, int64_t trials, int64_t steps, int pitch, Address signal, Address spikes, int threads
#define NT_SIGNALS_NAMES \
    nb::kw_only(), "is_double"_a, "trials"_a, "steps"_a, "pitch"_a, "signal"_a, "spikes"_a, "threads"_a

void add_encoders(nb::module_& m) {
    m.def("izhikevich",
          [](NT_SIGNALS, double sa_gain, double ra_gain, double step_ms, double recovers, double b, double c, double d,
             double peak, int euler_steps, bool has_last, Address last, Address membrane, Address recovery) {
              nb::gil_scoped_release release;
              const auto run = [&](auto real) -> double {
                  using T = decltype(real);
                  return kernels<T>().izhikevich({{trials, steps, pitch, at<const T>(signal), at<uint8_t>(spikes), threads},
                                                  T(sa_gain), T(ra_gain), T(step_ms), T(recovers), T(b), T(c), T(d), T(peak),
                                                  euler_steps, has_last, at<T>(last), at<T>(membrane), at<T>(recovery)});
              };
              return is_double ? run(double{}) : run(float{});
          },
          NT_SIGNALS_NAMES, "sa_gain"_a, "ra_gain"_a, "step_ms"_a, "recovers"_a, "b"_a, "c"_a, "d"_a, "peak"_a,
          "euler_steps"_a, "has_last"_a, "last"_a, "membrane"_a, "recovery"_a);
    m.def("bens_spiker",
          [](NT_SIGNALS, double gain, double threshold, int n_taps, Address taps, Address remaining) {
              nb::gil_scoped_release release;
              const auto run = [&](auto real) {
                  using T = decltype(real);
                  kernels<T>().bens_spiker({{trials, steps, pitch, at<const T>(signal), at<uint8_t>(spikes), threads},
                                            T(gain), T(threshold), n_taps, at<const T>(taps), at<T>(remaining)});
              };
              is_double ? run(double{}) : run(float{});
          },
          NT_SIGNALS_NAMES, "gain"_a, "threshold"_a, "n_taps"_a, "taps"_a, "remaining"_a);
    m.def("mechanoreceptors",
          [](NT_SIGNALS, int64_t first_step, int64_t first_fine, int64_t n_fine, Address step_of, Address share, int copies,
             Address fits, Address post_spike, int64_t post_spike_steps, int64_t longest_since, Address places, Address last,
             Address before, Address digest, Address kept, int64_t under_way, Address fired) {
              nb::gil_scoped_release release;
              const auto run = [&](auto real) {
                  using T = decltype(real);
                  kernels<T>().mechanoreceptors(
                      {{trials, steps, pitch, at<const T>(signal), at<uint8_t>(spikes), threads}, first_step, first_fine,
                       n_fine, at<const int64_t>(step_of), at<const double>(share), copies,
                       at<const MechanoreceptorFit>(fits), at<const double>(post_spike), post_spike_steps, longest_since,
                       at<const uint64_t>(places), at<double>(last), at<double>(before), at<uint64_t>(digest),
                       at<double>(kept), under_way, at<uint8_t>(fired)});
              };
              is_double ? run(double{}) : run(float{});
          },
          NT_SIGNALS_NAMES, "first_step"_a, "first_fine"_a, "n_fine"_a, "step_of"_a, "share"_a, "copies"_a, "fits"_a,
          "post_spike"_a, "post_spike_steps"_a, "longest_since"_a, "places"_a, "last"_a, "before"_a, "digest"_a, "kept"_a,
          "under_way"_a, "fired"_a);
}

#define NT_TALLY_ARGUMENTS                                                                                        \
    Address bin_of, int64_t bins, int64_t floor, Address ends, int64_t pitch, Address last_spike, Address intervals, \
        Address at_floor
#define NT_TALLY_NAMES "bin_of"_a, "bins"_a, "floor"_a, "ends"_a, "pitch"_a, "last_spike"_a, "intervals"_a, "at_floor"_a
#define NT_TALLY                                                                                                    \
    {at<const int32_t>(bin_of), bins, floor, at<const int64_t>(ends), pitch, at<int32_t>(last_spike),               \
     at<int32_t>(intervals), at<int64_t>(at_floor)}

// Spikes that are tallied as they come; of signals in float32, as calibration keeps them.
void add_tallies(nb::module_& m) {
    m.def("tally_raster",
          [](Address spikes, int64_t trials, int64_t trial_stride, int64_t time_stride, int64_t afferents,
             NT_TALLY_ARGUMENTS) {
              nb::gil_scoped_release release;
              tally_raster(at<const uint8_t>(spikes), trials, trial_stride, time_stride, afferents, NT_TALLY);
          },
          nb::kw_only(), "spikes"_a, "trials"_a, "trial_stride"_a, "time_stride"_a, "afferents"_a, NT_TALLY_NAMES);
    m.def("class_sums",
          [](Address rows, Address labels, int64_t labellings, int64_t trials, int64_t classes, int64_t n, Address sums) {
              nb::gil_scoped_release release;
              class_sums(at<const double>(rows), at<const int64_t>(labels), labellings, trials, classes, n,
                         at<double>(sums));
          },
          nb::kw_only(), "rows"_a, "labels"_a, "labellings"_a, "trials"_a, "classes"_a, "n"_a, "sums"_a);
    m.def("moving_average",
          [](Address signal, Address before, double newest, double kept, int64_t trials, int64_t steps, int64_t taxels,
             Address smooth) {
              nb::gil_scoped_release release;
              moving_average(at<const float>(signal), at<const float>(before), float(newest), float(kept), trials, steps,
                             taxels, at<float>(smooth));
          },
          nb::kw_only(), "signal"_a, "before"_a, "newest"_a, "kept"_a, "trials"_a, "steps"_a, "taxels"_a, "smooth"_a);
    m.def("tally_population",
          [](int64_t trials, int64_t steps, int taxels, Address felt, double gain, double decay, double v_rest,
             double v_reset, double v_threshold, int silent, int threads, NT_TALLY_ARGUMENTS) {
              nb::gil_scoped_release release;
              kernels<float>().tally({trials, steps, taxels, at<const float>(felt), float(gain), float(decay),
                                      float(v_rest), float(v_reset), float(v_threshold), silent, NT_TALLY, threads});
          },
          nb::kw_only(), "trials"_a, "steps"_a, "taxels"_a, "felt"_a, "gain"_a, "decay"_a, "v_rest"_a, "v_reset"_a,
          "v_threshold"_a, "silent"_a, "threads"_a, NT_TALLY_NAMES);
    m.def("tally_exact",
          [](int64_t trials, int64_t samples, int afferents, Address drive, Address t_ref_ms, double tau_ms,
             double v_rest, double v_reset, double v_threshold, double sample_ms, double steps_per_ms,
             double steps_per_sample, Address membrane, Address refractory_ms, int threads, NT_TALLY_ARGUMENTS) {
              nb::gil_scoped_release release;
              const Tally tally NT_TALLY;
              kernels<float>().encode_exact({trials, samples, 0, afferents, at<const float>(drive),
                                             at<const double>(t_ref_ms), tau_ms, v_rest, v_reset, v_threshold, sample_ms,
                                             steps_per_ms, steps_per_sample, 0, 0, at<double>(membrane),
                                             at<double>(refractory_ms), nullptr, threads, &tally});
          },
          nb::kw_only(), "trials"_a, "samples"_a, "afferents"_a, "drive"_a, "t_ref_ms"_a, "tau_ms"_a, "v_rest"_a,
          "v_reset"_a, "v_threshold"_a, "sample_ms"_a, "steps_per_ms"_a, "steps_per_sample"_a, "membrane"_a,
          "refractory_ms"_a, "threads"_a, NT_TALLY_NAMES);
}

constexpr float kLargest = 1e20f;  // of a sample (streams/chain.py)

// A chain that takes samples; it copies what it is made of, and its memory does not change from then on.
class Stream {
public:
    Stream(const StreamPlan& from, const std::vector<float>& gains, const std::vector<int32_t>& numbers, const Shape& shape,
           const Parameters& of, Address bias, Address offset, Address scale, Address fans, int64_t most_samples,
           int64_t most_decisions)
        : plan(from), most(most_samples), decided(most_decisions), last(from.taxels), of_afferents(numbers) {
        const Sizes& n = shape.sizes;
        const int64_t n_heard = n.hidden + shape.integration.direct * n.inputs;
        const int64_t sizes[] = {(int64_t)n.inputs * n.hidden, of.w_rec ? (int64_t)n.hidden * n.hidden : 0,
                                 shape.integration.stretches * n_heard * n.classes, 2, 2, 2};
        const Address from_where[] = {of.w_in, of.w_rec, of.w_out, of.alpha, of.beta, of.threshold};
        const float* to[6];
        for (int i = 0; i < 6; i++) to[i] = kept(from_where[i], sizes[i]);
        plan.offset = kept(offset, offset ? plan.taxels : 0);
        plan.scale = kept(scale, scale ? plan.taxels : 0);
        plan.fans = kept(fans, fans ? n.inputs + n.hidden : 0);
        plan.gains = kept(Address(gains.data()), gains.size());
        plan.numbers = of_afferents.empty() ? nullptr : of_afferents.data();
        if (bias) biases.assign(at<const double>(bias), at<const double>(bias) + n.classes);
        const Parameters own{Address(to[0]), Address(to[1]), Address(to[2]), Address(to[3]), Address(to[4]), Address(to[5])};
        Shape of_floats = shape;
        of_floats.recurrent = of.w_rec != 0;
        plan.net = make_net<float>(of_floats, 1, plan.length, {}, own, bias ? Address(biases.data()) : 0, 1);
        kernels = &stream_kernels();
        block = std::make_unique<Block>(kernels->bytes(plan));
        stream = kernels->make(plan, block->data());
    }
    Stream(const Stream&) = delete;

    // What was decided, a tuple for each window; None, and nothing done, where a sample is NaN, infinite or too large.
    nb::object push(const float* samples, int64_t n, bool held) {
        for (int64_t i = 0; i < n * plan.taxels; i++)
            if (!(std::fabs(samples[i]) <= kLargest)) return nb::none();
        const int64_t n_decided = kernels->push(plan, stream, samples, n, held, decided.data());
        nb::list found;
        for (int64_t i = 0; i < n_decided; i++) {
            const Decided& d = decided[i];
            if (plan.fans)
                found.append(nb::make_tuple(d.window, d.start, d.steps, d.label, d.input_spikes, d.hidden_spikes, d.held,
                                            d.heard != 0, d.sops));
            else
                found.append(nb::make_tuple(d.window, d.start, d.steps, d.label, d.input_spikes, d.hidden_spikes, d.held,
                                            d.heard != 0));
        }
        return found;
    }
    // The same of samples in a form that needs no preparation, at most `most` of them, which are counted; else None.
    nb::object take(nb::handle given) {
        nb::ndarray<const float, nb::c_contig, nb::device::cpu> samples;
        if (!nb::try_cast(given, samples, false)) return nb::none();
        const size_t axes = samples.ndim();
        if (axes < 1 || axes > 2 || (int64_t)samples.shape(axes - 1) != plan.taxels) return nb::none();
        const int64_t n = axes == 1 ? 1 : (int64_t)samples.shape(0);
        if (n < 1 || n > most) return nb::none();
        nb::object found = push(samples.data(), n, false);
        if (found.is_none()) return found;
        taken += n;
        std::copy_n(samples.data() + (n - 1) * plan.taxels, plan.taxels, last.data());
        return found;
    }
    // How many samples `take` took since this was asked last, and the values of the last one.
    nb::tuple counted() {
        const int64_t n = std::exchange(taken, 0);
        return nb::make_tuple(n, nb::bytes(last.data(), last.size() * sizeof(float)));
    }
    void begin() {
        taken = 0;
        kernels->begin(plan, stream);
    }
    // The whole state, of the type in streams/native.py.
    nb::bytes state() {
        std::string found;
        kernels->visit(plan, stream, {&found, [](void* to, void* here, size_t bytes) {
            static_cast<std::string*>(to)->append(static_cast<const char*>(here), bytes);
        }});
        return nb::bytes(found.data(), found.size());
    }
    void restore(const nb::bytes& state) {
        // The counters come first; the last of them says how many windows follow.
        constexpr size_t counters = 6 * sizeof(int64_t);
        int64_t under_way = -1;
        if (state.size() >= counters) std::memcpy(&under_way, state.c_str() + counters - sizeof under_way, sizeof under_way);
        if (under_way < 0 || under_way > plan.at_once) throw std::invalid_argument("state: too many windows");
        begin();
        struct Rest {
            const char* at;
            size_t bytes;
            bool fits;
        } rest{state.c_str(), state.size(), true};
        kernels->visit(plan, stream, {&rest, [](void* of, void* here, size_t bytes) {
            Rest& r = *static_cast<Rest*>(of);
            r.fits = r.fits && bytes <= r.bytes;
            if (!r.fits) return;
            std::memcpy(here, r.at, bytes);
            r.at += bytes;
            r.bytes -= bytes;
        }});
        if (!rest.fits || rest.bytes) throw std::invalid_argument("state: is not one of this stream");
    }
    // From now on each push writes down its steps, `room` of them at most.
    void watch(int64_t room) {
        const int64_t n_in = words(plan.net.sizes.inputs), n_hidden = words(plan.net.sizes.hidden);
        bits.assign(room * (n_in + n_hidden), 0);
        windows.assign(room, -1);
        trace = {bits.data(), bits.data() + room * n_in, windows.data(), room, 0, 0};
        plan.trace = &trace;
    }
    // Of the last push: its first step, and the rows of afferents, hidden neurons and windows.
    nb::tuple watched() const {
        const auto rows = [&](const void* at, int64_t row) { return nb::bytes(at, trace.steps * row * sizeof(uint64_t)); };
        return nb::make_tuple(trace.first, rows(trace.afferents, words(plan.net.sizes.inputs)),
                              rows(trace.hidden, words(plan.net.sizes.hidden)), rows(trace.window, 1));
    }
    int taxels() const { return plan.taxels; }

private:
    const float* kept(Address from, int64_t n) {
        if (!n) return nullptr;
        floats.emplace_back(at<const float>(from), at<const float>(from) + n);
        return floats.back().data();
    }
    StreamPlan plan;
    std::vector<std::vector<float>> floats;
    std::vector<double> biases;
    const std::vector<int32_t> of_afferents;
    int64_t most, taken = 0;
    std::vector<Decided> decided;
    std::vector<float> last;
    std::vector<uint64_t> bits;
    std::vector<int64_t> windows;
    StreamTrace trace{};
    const StreamKernels* kernels;
    std::unique_ptr<Block> block;
    void* stream;
};

using Samples = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void add_stream(nb::module_& m) {
    nb::class_<Stream>(m, "Stream")
        .def("__init__",
             [](Stream* self, const Shape& shape, int taxels, double factor, bool smooth, double smooth_new,
                double smooth_kept, bool resampled, double samples_per_step, int baseline, int64_t start_steps,
                double base_new, double base_kept, Address offset, Address scale, bool rectify,
                const std::vector<float>& sa_gains, const std::vector<float>& ra_gains,
                const std::vector<int32_t>& numbers, double decay, double v_rest, double v_reset, double v_threshold, int sa_silent,
                int ra_silent, int64_t length, int64_t start, int64_t hop, int64_t quiet, int64_t bin, int at_once,
                int64_t patience, bool from_first_spike, double least_lead, NT_PARAMETERS, Address bias, int64_t most_samples,
                int64_t most_decisions, Address fans) {
                 const int n_slow = int(sa_gains.size()), n_rapid = int(ra_gains.size());
                 const int64_t places = int64_t(n_slow + n_rapid) * taxels, none = std::count(numbers.begin(), numbers.end(), -1);
                 bool fits = shape.sizes.inputs == places - none && (numbers.empty() || places == (int64_t)numbers.size());
                 for (const int32_t number : numbers) fits = fits && number >= -1 && number < shape.sizes.inputs;
                 if (shape.is_double || !fits || taxels < 1 || at_once < 1 || length < 1 || bin < 1)
                     throw std::invalid_argument("stream: needs a network in float32 with an input for each afferent");
                 std::vector<float> gains(sa_gains);
                 gains.insert(gains.end(), ra_gains.begin(), ra_gains.end());
                 const StreamPlan plan{taxels, float(factor), smooth, resampled, rectify, float(smooth_new),
                                       float(smooth_kept), samples_per_step, Baseline(baseline), start_steps,
                                       float(base_new), float(base_kept), nullptr, nullptr, float(decay),
                                       float(v_rest), float(v_reset), float(v_threshold), sa_silent, ra_silent,
                                       nullptr, n_slow, n_rapid, nullptr, length, start, hop, quiet, bin, at_once,
                                       {patience, from_first_spike, least_lead}, {}};
                 new (self) Stream(plan, gains, numbers, shape, {w_in, w_rec, w_out, alpha, beta, threshold}, bias, offset, scale,
                                   fans, most_samples, most_decisions);
             },
             "shape"_a, nb::kw_only(), "taxels"_a, "factor"_a, "smooth"_a, "smooth_new"_a, "smooth_kept"_a, "resampled"_a,
             "samples_per_step"_a, "baseline"_a, "start_steps"_a, "base_new"_a, "base_kept"_a, "offset"_a, "scale"_a,
             "rectify"_a, "sa_gains"_a, "ra_gains"_a, "numbers"_a = std::vector<int32_t>{}, "decay"_a, "v_rest"_a, "v_reset"_a, "v_threshold"_a, "sa_silent"_a,
             "ra_silent"_a, "length"_a, "start"_a, "hop"_a, "quiet"_a, "bin"_a, "at_once"_a, "patience"_a,
             "from_first_spike"_a, "least_lead"_a, NT_PARAMETERS_NAMES, "bias"_a, "most_samples"_a, "most_decisions"_a,
             "fans"_a = Address(0))
        .def("push",
             [](Stream& self, const Samples& samples, bool held) {
                 if ((int64_t)samples.shape(1) != self.taxels()) throw std::invalid_argument("samples: another width");
                 return self.push(samples.data(), (int64_t)samples.shape(0), held);
             },
             nb::kw_only(), "samples"_a, "held"_a)
        .def("take", &Stream::take)
        .def("counted", &Stream::counted)
        .def("watch", [](Stream& self, int64_t room) {
            if (room < 1) throw std::invalid_argument("watch: needs room for a step");
            self.watch(room);
        })
        .def("watched", &Stream::watched)
        .def("state", &Stream::state)
        .def("restore", &Stream::restore);
}

constexpr const char* kIsaNames[] = {"plain", "avx2", "avx512"};

void set_isa_by_name(const std::string& name) {
    for (int i = 0; i < 3; i++)
        if (name == kIsaNames[i]) return set_isa(Isa(i));
    throw std::invalid_argument("instruction set '" + name + "' is unknown; known: plain, avx2, avx512");
}

}  // namespace

NB_MODULE(_native, m) {
    nb::set_leak_warnings(false);  // shapes stay cached to the end
    m.doc() = "Compiled kernels of neurotact; see docs/kernels.md. Use neurotact.networks and neurotact.encoders.";
    nb::class_<Shape>(m, "Shape");
    add_network(m);
    add_stream(m);
    add_exact(m);
    add_encoders(m);
    add_tallies(m);
    m.def("encode", &encode, nb::kw_only(), "is_double"_a, "trials"_a, "steps"_a, "taxels"_a, "signal"_a, "trial_stride"_a,
          "time_stride"_a, "sa_gain"_a, "ra_gain"_a, "decay"_a, "v_rest"_a, "v_reset"_a, "v_threshold"_a, "sa_silent"_a,
          "ra_silent"_a, "sa_membrane"_a, "ra_membrane"_a, "last"_a, "sa_silent_left"_a, "ra_silent_left"_a,
          "has_last"_a, "spikes"_a, "threads"_a);
    m.def("free_spare_blocks", &free_spare_blocks);
    m.def("isa", [] { return std::string(kIsaNames[int(current_isa())]); });
    m.def("widest_isa", [] { return std::string(kIsaNames[int(widest_isa())]); });
    m.def("set_isa", &set_isa_by_name);
}
