"""From conditioned signals to the spikes of mechanoreceptors.

Other rooms take:

    afferents: AfferentSpec, AfferentType, EncoderState, Integration, MODEL, POPULATIONS, encode, marks, under
    alternatives: COMPARED, compare, n_steps
    calibration: GRADES, calibrate, calibrate_causally, calibration_for, with_integration
    closed_form: AT_ONCE
    cost: NOT_COUNTED, encoding_cost, is_countable, no_cost
    encoding: Encoded, encode_copies, encode_file, encode_recordings
    firing: FiringWarning, complaint_at_rest, complaints, resting_table
    gain_search: CalibrationRule
    model: AnyEncoder, DrivenSpec, EncoderSpec, SENSITIVITY, name_in, names, of_name, usable
    sensitivity: sensitivities_of, value_of
    specs: BY_CALIBRATION, CLOCK_HZ, FITTED, PAST, afferent_names, conditioning_of, default_of, encode,
        encode_whole, exact_note, finish, is_exact, known_taxels, load, n_afferents, of_used, pays_exact,
        period_keys, populations, resolve, set_keys, t_ref_pair_ms, taxel_names, taxels_of, with_t_ref, with_t_refs
    transformer: SpikeEncoder
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
