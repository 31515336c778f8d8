/* Many values at a time. Not installed. */
#ifndef SVOI_CHANNEL_H
#define SVOI_CHANNEL_H

#include "svo_channel.h"

/* svo_linear_to_srgb of each. */
void svoi_linear_to_srgb(const float *v, uint64_t count, uint8_t *out);
/* The table that it is done with: by the upper halves of floats, from 0x3900 on, the encoded value << 17 and the lower half from which on it is one more. */
const uint32_t *svoi_srgb_steps(void);

#endif
