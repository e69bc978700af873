// The tank board: two relays or a motor driver, two normally closed contacts, perhaps a pressure sensor.
//
// The decisions are in tank_logic.h, which is tested on a computer. This file only reads pins and writes pins.
// Board: Arduino Uno, Nano or Mega. Serial: 115200 baud, one line each way.

#include "tank_logic.h"

#if defined(__AVR__)
#include <avr/wdt.h>
#endif

const uint8_t kFillPin = 7;    // HIGH: pump turns into the tank. 10 kOhm to ground, so that it is off while the board resets
const uint8_t kDrainPin = 8;   // HIGH: pump turns out of the tank. 10 kOhm to ground
const uint8_t kLeakPin = 2;    // contact to ground, closed while dry
const uint8_t kFullPin = 3;    // contact to ground, closed while the liquid stands below the over-fill float
const uint8_t kLevelPin = A0;  // level sensor, 0 to 5 V; tie it to ground if there is none
const uint8_t kLedPin = LED_BUILTIN;

tank::Logic logic;
char line[32];
uint8_t length = 0;
bool too_long = false;

void drive_pins() {
  // Off before on: the two are never on together.
  if (!logic.fill_on()) digitalWrite(kFillPin, LOW);
  if (!logic.drain_on()) digitalWrite(kDrainPin, LOW);
  if (logic.fill_on()) digitalWrite(kFillPin, HIGH);
  if (logic.drain_on()) digitalWrite(kDrainPin, HIGH);
  digitalWrite(kLedPin, logic.fill_on() || logic.drain_on());
}

tank::Inputs read_inputs() {
  tank::Inputs inputs;
  inputs.leak_open = digitalRead(kLeakPin) == HIGH;
  inputs.full_open = digitalRead(kFullPin) == HIGH;
  inputs.level = analogRead(kLevelPin);
  return inputs;
}

void say(const char* reply) {
  Serial.print(reply);
  Serial.print('\n');
}

void hear(char letter, uint32_t now_ms) {
  char reply[144];
  if (letter == '\r') return;
  if (letter != '\n') {
    if (length < sizeof line - 1) {
      line[length++] = letter;
    } else {
      too_long = true;
    }
    return;
  }
  line[length] = '\0';
  logic.command(too_long ? "" : line, now_ms, reply, sizeof reply);
  length = 0;
  too_long = false;
  drive_pins();  // before the answer: it must already be true
  say(reply);
}

void setup() {
  digitalWrite(kFillPin, LOW);
  digitalWrite(kDrainPin, LOW);
  pinMode(kFillPin, OUTPUT);
  pinMode(kDrainPin, OUTPUT);
  pinMode(kLedPin, OUTPUT);
  pinMode(kLeakPin, INPUT_PULLUP);
  pinMode(kFullPin, INPUT_PULLUP);
  Serial.begin(115200);
#if defined(__AVR__)
  wdt_enable(WDTO_250MS);  // a loop that hangs resets the board, and a reset board pumps nothing
#endif
  char reply[144];
  logic.tick(millis(), read_inputs());
  logic.greet(reply, sizeof reply);
  say(reply);
}

void loop() {
#if defined(__AVR__)
  wdt_reset();
#endif
  const uint32_t now_ms = millis();
  logic.tick(now_ms, read_inputs());
  drive_pins();
  if (Serial.available()) hear(Serial.read(), now_ms);
}
