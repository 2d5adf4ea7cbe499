/* Assertions of the tests. */
#ifndef CHECK_H
#define CHECK_H

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bcap.h"

#define CHECK(condition)                                                                                               \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                                           \
            exit(1);                                                                                                   \
        }                                                                                                              \
    } while (0)

/* Checks a status, and prints the one that was returned. */
#define STATUS(wanted, call)                                                                                           \
    do {                                                                                                               \
        bcap_status found_ = (call);                                                                                   \
        if (found_ != (wanted)) {                                                                                      \
            char text_[400], message_[400];                                                                            \
            bcap_status_text(found_, text_, sizeof text_);                                                             \
            fprintf(stderr, "%s:%d: %s returned %d: %s\n", __FILE__, __LINE__, #call, (int)found_, text_);             \
            MESSAGE(message_);                                                                                         \
            exit(1);                                                                                                   \
        }                                                                                                              \
    } while (0)

#ifdef SANS_IO
#define MESSAGE(buffer) (void)(buffer)
#else
#define MESSAGE(buffer) (bcap_message(buffer, sizeof buffer), fprintf(stderr, "%s\n", buffer))
#endif

#define OK(call) STATUS(BCAP_OK, call)

#endif
