/* The log categories of both faces: what becomes of a message depends on its status. */
#ifndef HT_CATEGORIES_H
#define HT_CATEGORIES_H

#include <stddef.h>

enum { HT_LOG_EVENTS = 1, HT_LOG_WARNING = 2, HT_LOG_DISCARD = 4, HT_LOG_ERROR = 8, HT_LOG_ALL = 15 };

/* Name and bit of the category of messages with an FMI status: OK, Warning, Discard, Error or Fatal. */
const char *ht_category_of(int status, int *bit);
/* The categories that are on after a call of SetDebugLogging; -1 when one is not of this FMU. Errors are logged always. */
int ht_categories_on(int on, size_t n, const char *const names[]);

#endif
