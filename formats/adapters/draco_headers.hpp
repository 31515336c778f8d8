/* Draco's headers, which our warnings must not see. */
#ifndef DRACO_HEADERS_HPP
#define DRACO_HEADERS_HPP

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"
#endif
#include <draco/compression/decode.h>
#include <draco/compression/expert_encode.h>
#include <draco/compression/point_cloud/point_cloud_decoder.h>
#include <draco/core/varint_decoding.h>
#include <draco/mesh/mesh.h>
#include <draco/metadata/metadata_decoder.h>
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif

#endif
