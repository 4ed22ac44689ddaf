/* The robot's program on an ESP32-S3 with ESP-IDF 5: the eight functions of fj_hal (board.h), Wi-Fi, and a task that ticks.
 *
 * Pins, servos and the network are build flags: platformio.ini. No target build was made and no board has run it; the tests compile
 * it on the host against the declarations in host/esp_idf.
 */
#include <string.h>

#include "board.h"
#include "driver/i2c_master.h"
#include "driver/uart.h"
#include "esp_err.h"
#include "esp_event.h"
#include "esp_log.h"
#include "esp_netif.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "esp_wifi.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "lwip/sockets.h"
#include "nvs_flash.h"

#if configTICK_RATE_HZ != 1000
#error "a wait of 3 ms needs CONFIG_FREERTOS_HZ=1000 (sdkconfig.defaults)"
#endif

#define SERVO_UART UART_NUM_1
#define SERVO_BAUD 115200
#define LINE_BYTES 256       /* of the UART's buffers */
#define SILENT_SYMBOLS 2     /* after which the UART hands over what has come */
#define SENT_MS 20u          /* that bytes may take to leave */
#define METER_ADDRESS 0x40u  /* INA226, A0 and A1 at ground */
#define METER_HZ 400000u
#define METER_MS 2           /* that it may take: one whole tick, whenever in a tick it begins */
#define PORT 2334u
#define TICK_MS 20u
#define STACK_BYTES 8192u
#define PRIORITY 20u         /* above lwIP's 18 */
#define CORE 1               /* Wi-Fi runs on core 0 */

static const char *const TAG = "fishmj";
static const uint8_t SERVO_IDS[] = {FJ_SERVO_IDS};
static const float SERVO_SIGNS[] = {FJ_SERVO_SIGNS}, SERVO_ZEROS[] = {FJ_SERVO_ZEROS};
/* one sign and one zero a servo: an array of a negative size does not compile */
typedef char each_servo_has_a_sign[sizeof SERVO_SIGNS == sizeof SERVO_IDS * sizeof(float) ? 1 : -1];
typedef char each_servo_has_a_zero[sizeof SERVO_ZEROS == sizeof SERVO_IDS * sizeof(float) ? 1 : -1];
static fj_board board;
static i2c_master_dev_handle_t meter;
static int radio = -1;
static struct sockaddr_in host; /* who sent the newest datagram */
static bool spoken_to = false;

static uint64_t now_us(void *at) {
    (void)at;
    return (uint64_t)esp_timer_get_time();
}

/* Datagrams of other computers are dropped while a host holds the robot. */
static size_t udp_receive(void *at, uint8_t *data, size_t room) {
    (void)at;
    for (uint8_t tries = 0; tries < FJ_DATAGRAMS; tries++) {
        struct sockaddr_in from;
        socklen_t size = sizeof from;
        int got = (int)recvfrom(radio, data, room, MSG_DONTWAIT, (struct sockaddr *)&from, &size);
        if (got <= 0) return 0;
        bool same = spoken_to && from.sin_addr.s_addr == host.sin_addr.s_addr && from.sin_port == host.sin_port;
        if (!same && spoken_to && board.robot.watchdog.state != FJ_IDLE) continue;
        host = from;
        spoken_to = true;
        return (size_t)got;
    }
    return 0;
}

static void udp_send(void *at, const uint8_t *data, size_t size) {
    (void)at;
    if (spoken_to) sendto(radio, data, size, MSG_DONTWAIT, (const struct sockaddr *)&host, sizeof host);
}

static void uart_write(void *at, const uint8_t *data, size_t size) {
    (void)at;
    uart_write_bytes(SERVO_UART, data, size);
    uart_wait_tx_done(SERVO_UART, pdMS_TO_TICKS(SENT_MS));
}

/* uart_read_bytes waits until all of `room` is there: so one byte is waited for, and the others are taken as they are. */
static size_t uart_read(void *at, uint8_t *data, size_t room, uint32_t wait_us) {
    (void)at;
    if (room == 0) return 0;
    if (uart_read_bytes(SERVO_UART, data, 1, pdMS_TO_TICKS((wait_us + 999u) / 1000u)) != 1) return 0;
    size_t more = 0;
    uart_get_buffered_data_len(SERVO_UART, &more);
    if (more > room - 1) more = room - 1;
    int got = more > 0 ? uart_read_bytes(SERVO_UART, data + 1, (uint32_t)more, 0) : 0;
    return 1u + (got > 0 ? (size_t)got : 0u);
}

static bool i2c_write(void *at, uint8_t reg, uint16_t word) {
    (void)at;
    const uint8_t bytes[3] = {reg, (uint8_t)(word >> 8), (uint8_t)(word & 0xffu)};
    return i2c_master_transmit(meter, bytes, sizeof bytes, METER_MS) == ESP_OK;
}

static bool i2c_read(void *at, uint8_t reg, uint16_t *word) {
    (void)at;
    uint8_t bytes[2];
    if (i2c_master_transmit_receive(meter, &reg, 1, bytes, sizeof bytes, METER_MS) != ESP_OK) return false;
    *word = (uint16_t)((uint16_t)(bytes[0] << 8) | bytes[1]);
    return true;
}

static void begin_servos(void) {
    uart_config_t line;
    memset(&line, 0, sizeof line);
    line.baud_rate = SERVO_BAUD;
    line.data_bits = UART_DATA_8_BITS;
    line.parity = UART_PARITY_DISABLE;
    line.stop_bits = UART_STOP_BITS_1;
    line.flow_ctrl = UART_HW_FLOWCTRL_DISABLE;
    line.source_clk = UART_SCLK_DEFAULT;
    ESP_ERROR_CHECK(uart_driver_install(SERVO_UART, LINE_BYTES, 0, 0, NULL, 0));
    ESP_ERROR_CHECK(uart_param_config(SERVO_UART, &line));
    ESP_ERROR_CHECK(uart_set_pin(SERVO_UART, FJ_PIN_SERVO_TX, FJ_PIN_SERVO_RX, FJ_PIN_SERVO_SEND, UART_PIN_NO_CHANGE));
    ESP_ERROR_CHECK(uart_set_mode(SERVO_UART, UART_MODE_RS485_HALF_DUPLEX)); /* the third pin opens the buffer while it sends */
    ESP_ERROR_CHECK(uart_set_rx_timeout(SERVO_UART, SILENT_SYMBOLS));
}

static void begin_meter(void) {
    i2c_master_bus_config_t wires;
    i2c_device_config_t chip;
    i2c_master_bus_handle_t bus;
    memset(&wires, 0, sizeof wires);
    wires.i2c_port = I2C_NUM_0;
    wires.sda_io_num = FJ_PIN_SDA;
    wires.scl_io_num = FJ_PIN_SCL;
    wires.clk_source = I2C_CLK_SRC_DEFAULT;
    wires.glitch_ignore_cnt = 7;
    memset(&chip, 0, sizeof chip);
    chip.dev_addr_length = I2C_ADDR_BIT_LEN_7;
    chip.device_address = METER_ADDRESS;
    chip.scl_speed_hz = METER_HZ;
    ESP_ERROR_CHECK(i2c_new_master_bus(&wires, &bus));
    ESP_ERROR_CHECK(i2c_master_bus_add_device(bus, &chip, &meter));
}

/* Connect, and again whenever the access point is lost. */
static void on_wifi(void *at, esp_event_base_t base, int32_t id, void *data) {
    (void)at, (void)base, (void)data;
    if (id == WIFI_EVENT_STA_START || id == WIFI_EVENT_STA_DISCONNECTED) esp_wifi_connect();
}

static void begin_radio(void) {
    static const char ssid[] = FJ_WIFI_SSID, password[] = FJ_WIFI_PASSWORD;
    wifi_init_config_t driver = WIFI_INIT_CONFIG_DEFAULT();
    wifi_config_t network;
    struct sockaddr_in here;
    memset(&network, 0, sizeof network);
    memcpy(network.sta.ssid, ssid, sizeof ssid - 1 < sizeof network.sta.ssid ? sizeof ssid - 1 : sizeof network.sta.ssid);
    memcpy(network.sta.password, password,
           sizeof password - 1 < sizeof network.sta.password ? sizeof password - 1 : sizeof network.sta.password);
    ESP_ERROR_CHECK(nvs_flash_init());
    ESP_ERROR_CHECK(esp_netif_init());
    ESP_ERROR_CHECK(esp_event_loop_create_default());
    esp_netif_create_default_wifi_sta();
    ESP_ERROR_CHECK(esp_wifi_init(&driver));
    ESP_ERROR_CHECK(esp_event_handler_register(WIFI_EVENT, ESP_EVENT_ANY_ID, on_wifi, NULL));
    ESP_ERROR_CHECK(esp_wifi_set_mode(WIFI_MODE_STA));
    ESP_ERROR_CHECK(esp_wifi_set_config(WIFI_IF_STA, &network));
    ESP_ERROR_CHECK(esp_wifi_start());
    ESP_ERROR_CHECK(esp_wifi_set_ps(WIFI_PS_NONE)); /* else datagrams are up to 102 ms late */
    memset(&here, 0, sizeof here);
    here.sin_family = AF_INET;
    here.sin_port = htons(PORT);
    here.sin_addr.s_addr = htonl(INADDR_ANY);
    radio = socket(AF_INET, SOCK_DGRAM, IPPROTO_UDP);
    if (radio < 0 || bind(radio, (const struct sockaddr *)&here, sizeof here) != 0) ESP_ERROR_CHECK(ESP_FAIL);
}

static void run(void *at) {
    (void)at;
    ESP_ERROR_CHECK(esp_task_wdt_add(NULL));
    TickType_t woken = xTaskGetTickCount();
    for (;;) {
        fj_board_tick(&board);
        esp_task_wdt_reset();
        vTaskDelayUntil(&woken, pdMS_TO_TICKS(TICK_MS));
    }
}

void app_main(void) {
    static const fj_hal hal = {NULL, now_us, udp_receive, udp_send, uart_write, uart_read, i2c_write, i2c_read};
    fj_parts parts;
    memset(&parts, 0, sizeof parts);
    parts.info.joints = (uint8_t)sizeof SERVO_IDS;
    parts.info.hold_us = 100000;
    parts.info.neutral_us = 300000;
    memcpy(parts.info.firmware, "fishmj-esp32s3-0.1.0", 21);
    for (uint8_t k = 0; k < parts.info.joints && k < FJ_MAX_JOINTS; k++) {
        parts.info.servo_id[k] = SERVO_IDS[k];
        parts.info.name[k][0] = 'j';
        parts.info.name[k][1] = (char)('1' + k);
        parts.sign[k] = SERVO_SIGNS[k];
        parts.zero[k] = SERVO_ZEROS[k];
    }
    parts.shunt_ohm = FJ_SHUNT_OHM;
    parts.most_ampere = FJ_MOST_AMPERE;
    parts.low_battery = FJ_LOW_BATTERY;
    begin_servos();
    begin_meter();
    begin_radio();
    if (!fj_board_init(&board, &hal, &parts)) {
        ESP_LOGE(TAG, "servo numbers, signs or zeros cannot be: see platformio.ini");
        return; /* without a tick: the servos have no torque */
    }
    xTaskCreatePinnedToCore(run, "fishmj", STACK_BYTES, NULL, PRIORITY, NULL, CORE);
}
