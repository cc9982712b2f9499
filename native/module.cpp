// The Python module. Tensors and arrays come as addresses, by name: the Python side has checked their shapes and types,
// and handing over a dozen of them as objects would cost more than a small kernel.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <stdexcept>
#include <string>

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
    double scale, readout_scale;
    bool is_double, recurrent, per_neuron, keep_currents;
    Layout layout;
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
    tape.readout_membrane = carver.take<T>(readout);
    tape.current = shape.keep_currents ? carver.take<T>(hidden) : nullptr;
    tape.readout_current = shape.keep_currents ? carver.take<T>(readout) : nullptr;
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
            sizes.classes ? at<const T>(of.w_out) : nullptr, hidden, readout, at<const double>(bias), threads};
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
          [](int inputs, int hidden, int classes, int membrane, int reset, int recurrent_delay, double scale,
             double readout_scale, bool is_double, bool recurrent, bool per_neuron, bool keep_currents, bool with_inputs,
             bool with_raster) -> Shape {
              const Sizes sizes{0, 0, inputs, hidden, classes};
              const Neuron neuron{Membrane(membrane), Reset(reset), recurrent_delay};
              const Layout layout = layout_of(sizes, neuron, is_double, with_inputs || with_raster || per_neuron);
              return {sizes, neuron, scale, readout_scale, is_double, recurrent, per_neuron, keep_currents, layout};
          },
          nb::kw_only(), "inputs"_a, "hidden"_a, "classes"_a, "membrane"_a, "reset"_a, "recurrent_delay"_a, "scale"_a,
          "readout_scale"_a, "is_double"_a, "recurrent"_a, "per_neuron"_a, "keep_currents"_a, "with_inputs"_a,
          "with_raster"_a);
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
                  return kernels<T>().infer(make_net<T>(shape, trials, steps, in, of, bias, threads),
                                            {patience, from_first_spike}, to);
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
    m.def("encode", &encode, nb::kw_only(), "is_double"_a, "trials"_a, "steps"_a, "taxels"_a, "signal"_a, "trial_stride"_a,
          "time_stride"_a, "sa_gain"_a, "ra_gain"_a, "decay"_a, "v_rest"_a, "v_reset"_a, "v_threshold"_a, "sa_silent"_a,
          "ra_silent"_a, "sa_membrane"_a, "ra_membrane"_a, "last"_a, "sa_silent_left"_a, "ra_silent_left"_a,
          "has_last"_a, "spikes"_a, "threads"_a);
    m.def("free_spare_blocks", &free_spare_blocks);
    m.def("isa", [] { return std::string(kIsaNames[int(current_isa())]); });
    m.def("widest_isa", [] { return std::string(kIsaNames[int(widest_isa())]); });
    m.def("set_isa", &set_isa_by_name);
}
