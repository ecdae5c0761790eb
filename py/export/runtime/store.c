/* The whole state is one flat array: saving is a copy. */
#include <string.h>

#include "internal.h"

size_t ht_state_bytes(const ht_model *m) { return ht_doubles(m) * sizeof(double); }

void ht_save(const ht_instance *s, void *state) { memcpy(state, s->data, ht_state_bytes(s->model)); }

ht_status ht_load(ht_instance *s, const void *state) {
    double interface;
    if (ht_phase_of(s) == HT_BETWEEN) return ht_fail(s, HT_ERROR, "the state cannot be set inside a step");
    size_t place = (size_t)(ht_book(s) - s->data) + INTERFACE;
    memcpy(&interface, (const char *)state + place * sizeof(double), sizeof(double));
    if (interface != (double)s->interface)
        return ht_fail(s, HT_ERROR, "a state of Co-Simulation is not one of Model Exchange");
    memcpy(s->data, state, ht_state_bytes(s->model));
    return HT_OK;
}

size_t ht_serialized_bytes(const ht_model *m) { return strlen(m->guid) + 1 + ht_state_bytes(m); }

ht_status ht_serialize(ht_instance *s, const void *state, void *bytes, size_t size) {
    size_t head = strlen(s->model->guid) + 1;
    if (size < ht_serialized_bytes(s->model))
        return ht_fail(s, HT_ERROR, "the buffer is too small for the serialized state");
    memcpy(bytes, s->model->guid, head);
    memcpy((char *)bytes + head, state, ht_state_bytes(s->model));
    return HT_OK;
}

ht_status ht_check_serialized(ht_instance *s, const void *bytes, size_t size) {
    size_t head = strlen(s->model->guid) + 1;
    if (size < ht_serialized_bytes(s->model) || memcmp(bytes, s->model->guid, head) != 0)
        return ht_fail(s, HT_ERROR, "the bytes are not a state of this FMU");
    return HT_OK;
}

void ht_deserialize(const ht_instance *s, const void *bytes, void *state) {
    memcpy(state, (const char *)bytes + strlen(s->model->guid) + 1, ht_state_bytes(s->model));
}
