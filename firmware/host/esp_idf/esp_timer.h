/* Declarations that esp32s3/main.c uses, after the API reference of ESP-IDF 5; for the tests on the host. */
#ifndef STUB_ESP_TIMER_H
#define STUB_ESP_TIMER_H

#include <stdint.h>

int64_t esp_timer_get_time(void); /* us since boot */

#endif
