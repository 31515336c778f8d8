/* Values of one channel of a subtree, packed: what repeats costs next to nothing, the rest is the difference to the value before, in as few
 * bits as a group of eight needs. docs/format/svo.md is normative. Not installed. */
#ifndef FMTI_SVO_VALUES_H
#define FMTI_SVO_VALUES_H

#include "svo_alloc.h"
#include "svo_channel.h"

/* Append `count` values (interleaved, in depth-first order) to *to. The bytes depend on the values alone. SVO_OUT_OF_MEMORY. */
svo_result fmti_values_encode(svo_channel_kind kind, const uint8_t *values, uint64_t count, const svo_allocator *a, svo_buffer *to, svo_error *err);

/* Decode exactly `count` values from the bytes at *at, which is moved behind them, to `values` (interleaved; room for count * stride).
 * SVO_INVALID_DATA (SVO-13) when they end early or say what the rules forbid. Time and memory are linear in `count`. */
svo_result fmti_values_decode(svo_channel_kind kind, const uint8_t **at, const uint8_t *end, uint64_t count, const svo_allocator *a, uint8_t *values,
                              svo_error *err);

#endif
