/* Many values at a time. Not installed. */
#ifndef SVOI_CHANNEL_H
#define SVOI_CHANNEL_H

#include "svo_channel.h"

/* svo_linear_to_srgb of each. */
void svoi_linear_to_srgb(const float *v, uint64_t count, uint8_t *out);

#endif
