/* The triangles of a mesh, where its instances place them, as a scene of Embree 3. */
#ifndef EMBREE_MESH_H
#define EMBREE_MESH_H

#include <embree3/rtcore.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "svo_mesh.h"

/* Where a point goes before it is built. */
typedef svo_vec3 (*embree_move)(const void *user, svo_vec3 p);

/* Built as well as Embree can; free by rtcReleaseScene. Ends the program where there is no memory. move: NULL, or of each corner. */
static RTCScene embree_scene(RTCDevice device, const svo_mesh *m, embree_move move, const void *user)
{
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
    for (uint32_t i = 0; i < m->instance_count; i++) {
        const svo_shape *shape = &m->shapes[m->instances[i].shape];
        for (uint32_t p = 0; p < shape->part_count; p++) {
            const svo_part *part = &shape->parts[p];
            if (part->triangle_count == 0) continue;
            RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
            float *v = rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, part->vertex_count);
            uint32_t *t = rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, part->triangle_count);
            if (v == NULL || t == NULL) fputs("Embree: out of memory\n", stderr), exit(1);
            for (uint64_t k = 0; k < part->vertex_count; k++) {
                const double *x = part->positions + 3 * k;
                svo_vec3 at = svo_mat4_point(&m->instances[i].transform, svo_v3(x[0], x[1], x[2]));
                if (move != NULL) at = move(user, at);
                v[3 * k] = (float)at.x, v[3 * k + 1] = (float)at.y, v[3 * k + 2] = (float)at.z;
            }
            memcpy(t, part->indices, 12 * part->triangle_count);
            rtcCommitGeometry(g);
            rtcAttachGeometry(scene, g);
            rtcReleaseGeometry(g);
        }
    }
    rtcCommitScene(scene);
    return scene;
}

#endif
