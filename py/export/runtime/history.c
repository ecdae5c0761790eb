#include <math.h>

#include "history.h"

#define COUNT 0
#define NEWEST 1
#define PIECES 2
#define HT_SAME 1e-9 /* of a piece, of a value: what differs less is the same */

size_t ht_history_doubles(size_t pieces) { return PIECES + HT_PIECE * pieces; }

void ht_history_clear(double *history) {
    history[COUNT] = 0.0;
    history[NEWEST] = 0.0;
}

/* the piece `age` pieces before the newest */
static const double *piece(const double *history, size_t capacity, size_t age) {
    size_t newest = (size_t)history[NEWEST];
    return history + PIECES + HT_PIECE * ((newest + capacity - age) % capacity);
}

static void write_piece(double *history, size_t place, double time, double value, double slope) {
    double *p = history + PIECES + HT_PIECE * place;
    p[0] = time;
    p[1] = value;
    p[2] = slope;
}

static double integral(const double *p, double from, double to) {
    return (to - from) * (p[1] + p[2] * (0.5 * (from + to) - p[0]));
}

/* Make room in a full history: the two neighbours that together are shortest become one piece with their integral.
   The newest piece has no end yet and stays as it is. */
static void merge_shortest(double *history, size_t capacity) {
    size_t count = (size_t)history[COUNT], newest = (size_t)history[NEWEST], age, chosen = 2;
    double shortest = -1.0, from, middle, to, mean;
    const double *a, *b;
    for (age = 2; age < count; age++) {
        double length = piece(history, capacity, age - 2)[0] - piece(history, capacity, age)[0];
        if (shortest < 0.0 || length <= shortest) {
            shortest = length;
            chosen = age;
        }
    }
    a = piece(history, capacity, chosen);
    b = piece(history, capacity, chosen - 1);
    from = a[0], middle = b[0], to = piece(history, capacity, chosen - 2)[0];
    mean = (integral(a, from, middle) + integral(b, middle, to)) / (to - from);
    write_piece(history, (newest + capacity - chosen) % capacity, from, mean, 0.0);
    for (age = chosen - 1; age > 0; age--) {
        const double *p = piece(history, capacity, age - 1);
        write_piece(history, (newest + capacity - age) % capacity, p[0], p[1], p[2]);
    }
    history[NEWEST] = (double)((newest + capacity - 1) % capacity);
    history[COUNT] = (double)(count - 1);
}

void ht_history_push(double *history, size_t capacity, double time, double value, double slope, double horizon) {
    size_t count = (size_t)history[COUNT];
    if (count > 0) {
        const double *newest = piece(history, capacity, 0);
        if (newest[0] >= time) {
            write_piece(history, (size_t)history[NEWEST], newest[0], value, slope);
            return;
        }
        if (slope == 0.0 && newest[2] == 0.0 && newest[1] == value) return;
    }
    if (count == capacity && piece(history, capacity, count - 2)[0] > horizon) {
        merge_shortest(history, capacity);
        count = (size_t)history[COUNT];
    }
    if (count > 0) history[NEWEST] = (double)(((size_t)history[NEWEST] + 1) % capacity);
    if (count < capacity) history[COUNT] = (double)(count + 1);
    write_piece(history, (size_t)history[NEWEST], time, value, slope);
}

void ht_history_at(const double *history, size_t capacity, double time, double *value, double *slope) {
    size_t count = (size_t)history[COUNT], age;
    double slack = 1e-12 * (1.0 + (time < 0.0 ? -time : time)); /* rounding: an instant this near is met */
    const double *p = history;
    for (age = 0; age < count; age++) {
        p = piece(history, capacity, age);
        if (p[0] <= time + slack) {
            *value = p[1] + p[2] * (time - p[0]);
            *slope = p[2];
            return;
        }
    }
    *value = p[1];
    *slope = 0.0;
}

double ht_history_mean(const double *history, size_t capacity, double from, double to) {
    size_t count = (size_t)history[COUNT], age;
    double end = to, sum = 0.0;
    const double *p = history;
    for (age = 0; age < count && end > from; age++) {
        p = piece(history, capacity, age);
        if (end > p[0]) {
            double begin = p[0] > from ? p[0] : from;
            sum += integral(p, begin, end);
            end = begin;
        }
    }
    if (end > from) sum += p[1] * (end - from);
    return sum / (to - from);
}

double ht_history_jump(const double *history, size_t capacity, double from, double to) {
    size_t count = (size_t)history[COUNT], age;
    double found = to;
    for (age = 0; age + 1 < count; age++) {
        const double *p = piece(history, capacity, age), *before = piece(history, capacity, age + 1);
        double ended = before[1] + before[2] * (p[0] - before[0]), near = HT_SAME * (p[0] - before[0]);
        if (p[0] <= from + near) break;
        if (p[0] < found - near && fabs(p[1] - ended) > HT_SAME * (fabs(p[1]) + fabs(ended))) found = p[0];
    }
    return found;
}
