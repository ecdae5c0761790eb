#include <string.h>

#include "categories.h"

#define CATEGORIES 4
static const char *const names_of[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};

const char *ht_category_of(int status, int *bit) {
    int place = status < CATEGORIES ? status : CATEGORIES - 1;
    *bit = 1 << place;
    return names_of[place];
}

int ht_categories_on(int on, size_t n, const char *const names[]) {
    int wanted = n ? 0 : HT_LOG_ALL;
    size_t k;
    for (k = 0; k < n; k++) {
        int place = 0;
        while (place < CATEGORIES && (!names[k] || strcmp(names[k], names_of[place]) != 0)) place++;
        if (place == CATEGORIES) return -1;
        wanted |= 1 << place;
    }
    return on ? wanted : 0;
}
