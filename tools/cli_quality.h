/* Options that have a little language of their own and belong to several tools. Both functions return -1 to go on, or print
 * what is wrong and return the exit code to leave with, as cli_usage does. */
#ifndef CLI_QUALITY_H
#define CLI_QUALITY_H

#include "cli.h"
#include "svo_dag.h"

/* --color lossless|BITS|deltaE=X and --normal lossless|BITS|deg=X into the four fields of the options. */
int cli_take_quality(cli *c, const char *color, const char *normal, svo_dag_options *options);

/* --attributes auto, none or a comma-separated list of channels, as SVO_WANT_* bits. */
int cli_take_channels(cli *c, const char *list, uint32_t *channels);

#endif
