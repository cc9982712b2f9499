// The Python module. Tensors and arrays come as addresses: the Python side has checked their shapes and types, and
// handing over a dozen of them as objects would cost more than a small kernel.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <stdexcept>
#include <string>

#include "dispatch.hpp"
#include "memory.hpp"

namespace nb = nanobind;
using namespace neurotact;

namespace {

using Address = uintptr_t;

template <class T>
T* at(Address address) {
    return reinterpret_cast<T*>(address);
}

// The part of a call that does not depend on the float type. Python makes one for each shape of a network and keeps it.
struct Shape {
    Sizes sizes;
    Membrane membrane;
    Reset reset;
    int recurrent_delay;
    double scale;
    bool recurrent, per_neuron, keep_currents, with_inputs;
    Layout layout;
};

Shape make_shape(int inputs, int hidden, int classes, int membrane, int reset, int recurrent_delay, double scale,
                 bool recurrent, bool per_neuron, bool keep_currents, bool with_inputs) {
    const Sizes sizes{0, 0, inputs, hidden, classes};
    const Layout layout = layout_of(sizes, Membrane(membrane), recurrent_delay, recurrent, keep_currents || with_inputs);
    return {sizes,     Membrane(membrane), Reset(reset),  recurrent_delay, scale,
            recurrent, per_neuron,         keep_currents, with_inputs,     layout};
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

size_t tape_bytes(const Shape& shape, bool is_double, int64_t trials, int64_t steps) {
    Carver carver;
    if (is_double) cut_tape<double>(shape, trials, steps, carver);
    else cut_tape<float>(shape, trials, steps, carver);
    return carver.bytes();
}

// A block of the pool that Python holds as a tensor, so that autograd frees it with what else it has saved.
nb::ndarray<nb::pytorch, uint8_t, nb::ndim<1>> new_tape(const Shape& shape, bool is_double, int64_t trials, int64_t steps) {
    auto* block = new Block(tape_bytes(shape, is_double, trials, steps));
    nb::capsule owner(block, [](void* p) noexcept { delete static_cast<Block*>(p); });
    return {block->data(), {tape_bytes(shape, is_double, trials, steps)}, owner};
}

template <class T>
Net<T> make_net(const Shape& shape, int64_t trials, int64_t steps, const SpikesIn& spikes, Address w_in, Address w_rec,
                Address w_out, Address alpha, Address beta, Address threshold, int threads) {
    Sizes sizes = shape.sizes;
    sizes.trials = trials;
    sizes.steps = steps;
    // A fused network has two values of each: the hidden layer's and the readout's.
    const int stride = shape.per_neuron ? 1 : 0;
    const Dynamics<T> hidden{at<const T>(alpha), at<const T>(beta), at<const T>(threshold), stride};
    const Dynamics<T> readout{hidden.alpha + 1, hidden.beta + 1, hidden.threshold + 1, stride};
    return {sizes, spikes, shape.membrane, shape.reset, shape.recurrent_delay, at<const T>(w_in),
            shape.recurrent ? at<const T>(w_rec) : nullptr, sizes.classes ? at<const T>(w_out) : nullptr,
            hidden, readout, static_cast<T>(shape.scale), threads};
}

template <class T>
bool forward_as(const Shape& shape, int64_t trials, int64_t steps, const SpikesIn& spikes, Address w_in, Address w_rec,
                Address w_out, Address alpha, Address beta, Address threshold, Address tape_at, Address readout,
                Address hidden, Address raster, int threads) {
    const Net<T> net = make_net<T>(shape, trials, steps, spikes, w_in, w_rec, w_out, alpha, beta, threshold, threads);
    const Outputs<T> out{at<T>(readout), at<T>(hidden), at<T>(raster)};
    Carver carver(at<char>(tape_at));
    const Tape<T> tape = cut_tape<T>(shape, trials, steps, carver);
    const auto run = shape.layout.small ? kernels<T>().small_forward : kernels<T>().wide_forward;
    return run(net, shape.layout, out, tape_at ? &tape : nullptr);
}

bool forward(const Shape& shape, bool is_double, int64_t trials, int64_t steps, Address spikes, int spike_kind,
             int64_t trial_stride, int64_t time_stride, Address w_in, Address w_rec, Address w_out, Address alpha,
             Address beta, Address threshold, Address tape, Address readout, Address hidden, Address raster, int threads) {
    nb::gil_scoped_release release;
    const SpikesIn in{at<const void>(spikes), SpikesIn::Kind(spike_kind), trial_stride, time_stride};
    const auto run = is_double ? forward_as<double> : forward_as<float>;
    return run(shape, trials, steps, in, w_in, w_rec, w_out, alpha, beta, threshold, tape, readout, hidden, raster, threads);
}

template <class T>
void backward_as(const Shape& shape, int64_t trials, int64_t steps, Address tape_at, Address w_in, Address w_rec,
                 Address w_out, Address alpha, Address beta, Address threshold, Address g_readout, Address g_hidden,
                 Address g_raster, Address g_w_in, Address g_w_rec, Address g_w_out, Address g_spikes, Address g_dynamics,
                 int threads) {
    const Net<T> net = make_net<T>(shape, trials, steps, {}, w_in, w_rec, w_out, alpha, beta, threshold, threads);
    Carver carver(at<char>(tape_at));
    const Tape<T> tape = cut_tape<T>(shape, trials, steps, carver);
    const Gradients<T> grad{at<const T>(g_readout), at<const T>(g_hidden), at<const T>(g_raster), at<T>(g_w_in),
                            at<T>(g_w_rec), at<T>(g_w_out), at<T>(g_spikes), at<T>(g_dynamics)};
    const auto run = shape.layout.small ? kernels<T>().small_backward : kernels<T>().wide_backward;
    run(net, shape.layout, tape, grad);
}

void backward(const Shape& shape, bool is_double, int64_t trials, int64_t steps, Address tape, Address w_in, Address w_rec,
              Address w_out, Address alpha, Address beta, Address threshold, Address g_readout, Address g_hidden,
              Address g_raster, Address g_w_in, Address g_w_rec, Address g_w_out, Address g_spikes, Address g_dynamics,
              int threads) {
    nb::gil_scoped_release release;
    const auto run = is_double ? backward_as<double> : backward_as<float>;
    run(shape, trials, steps, tape, w_in, w_rec, w_out, alpha, beta, threshold, g_readout, g_hidden, g_raster, g_w_in,
        g_w_rec, g_w_out, g_spikes, g_dynamics, threads);
}

template <class T>
bool infer_as(const Shape& shape, int64_t trials, int64_t steps, const SpikesIn& spikes, Address w_in, Address w_rec,
              Address w_out, Address alpha, Address beta, Address threshold, const ExitRule& rule, const Decisions& to,
              int threads) {
    const Net<T> net = make_net<T>(shape, trials, steps, spikes, w_in, w_rec, w_out, alpha, beta, threshold, threads);
    return kernels<T>().infer(net, shape.layout, rule, to);
}

bool infer(const Shape& shape, bool is_double, int64_t trials, int64_t steps, Address spikes, int spike_kind,
           int64_t trial_stride, int64_t time_stride, Address w_in, Address w_rec, Address w_out, Address alpha,
           Address beta, Address threshold, int64_t patience, bool from_first_spike, Address labels, Address steps_out,
           Address input_spikes, Address hidden_spikes, Address readout, int threads) {
    nb::gil_scoped_release release;
    const SpikesIn in{at<const void>(spikes), SpikesIn::Kind(spike_kind), trial_stride, time_stride};
    const Decisions to{at<int64_t>(labels), at<int64_t>(steps_out), at<int64_t>(input_spikes), at<int64_t>(hidden_spikes),
                       at<int64_t>(readout)};
    const auto run = is_double ? infer_as<double> : infer_as<float>;
    return run(shape, trials, steps, in, w_in, w_rec, w_out, alpha, beta, threshold, {patience, from_first_spike}, to, threads);
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
    m.def("make_shape", &make_shape);
    m.def("new_tape", &new_tape);
    m.def("tape_bytes", &tape_bytes);
    m.def("forward", &forward);
    m.def("backward", &backward);
    m.def("infer", &infer);
    m.def("encode", &encode);
    m.def("free_spare_blocks", &free_spare_blocks);
    m.def("isa", [] { return std::string(kIsaNames[int(current_isa())]); });
    m.def("widest_isa", [] { return std::string(kIsaNames[int(widest_isa())]); });
    m.def("set_isa", &set_isa_by_name);
}
