// A CiA 402 drive on the npm stack `canopen`: SDO server, NMT, PDO, SYNC, heartbeat both ways and
// EMCY are the stack's; the objects and the state machine of the profile are here.
//
// Lines on stdin: "205#0F00..." a frame; "@1.005" the time is 1.005 s, answered by "." once all
// that was due is out; "!fault", "!emcy 3210", "!reboot" happen to the drive. Frames on stdout.
// Time comes from stdin alone, so that a slow machine changes nothing.

'use strict';

// node-crc is a native module that serves block transfers only: it need not be built.
const Module = require('module');
const load = Module._load;
Module._load = (name, ...rest) => (name === 'node-crc' ? { crc() {} } : load(name, ...rest));

// ---- time ---------------------------------------------------------------------------------------

let now = 0; // ms
const timers = new Set();

class Timer {
  constructor(callback, delay, repeat) {
    Object.assign(this, { callback, delay, repeat, due: now + delay });
    timers.add(this);
  }
  refresh() {
    this.due = now + this.delay;
    timers.add(this);
    return this;
  }
}
globalThis.setTimeout = (callback, delay) => new Timer(callback, delay, false);
globalThis.setInterval = (callback, delay) => new Timer(callback, delay, true);
globalThis.clearTimeout = globalThis.clearInterval = (timer) => timers.delete(timer);
Date.now = () => now;

function advance(time) {
  for (;;) {
    const due = [...timers].filter((t) => t.due <= time).sort((a, b) => a.due - b.due)[0];
    if (!due) break;
    now = Math.max(now, due.due);
    if (due.repeat) due.due += due.delay;
    else timers.delete(due);
    due.callback();
  }
  now = time;
}

// ---- objects ------------------------------------------------------------------------------------

const { Device, Eds, DataType, ObjectType, AccessType } = require('canopen');
const NODE = Number(process.argv[2]);
const { INTEGER8, INTEGER16, INTEGER32, UNSIGNED8, UNSIGNED16, UNSIGNED32 } = DataType;

const eds = new Eds();
const ro = AccessType.READ_ONLY;

function variable(index, dataType, value, accessType = AccessType.READ_WRITE) {
  if (eds.getEntry(index)) eds.removeEntry(index);
  const parameterName = index.toString(16);
  const entry = eds.addEntry(index, { parameterName, dataType, accessType });
  entry.value = value;
  return entry;
}

function record(index, types, values) {
  const entry = eds.addEntry(index, {
    parameterName: index.toString(16), objectType: ObjectType.RECORD,
  });
  types.forEach((dataType, i) => {
    entry.addSubObject(i + 1, { parameterName: `${index.toString(16)}.${i + 1}`, dataType });
    entry[i + 1].value = values[i];
  });
  return entry;
}

variable(0x1000, UNSIGNED32, 0x00020192, ro);
record(0x1016, [UNSIGNED32], [0]);
variable(0x1017, UNSIGNED16, 0);
variable(0x6007, INTEGER16, 0);
const errorCode = variable(0x603f, UNSIGNED16, 0, ro);
const controlword = variable(0x6040, UNSIGNED16, 0);
const statusword = variable(0x6041, UNSIGNED16, 0x0250, ro);
const quickStopOption = variable(0x605a, INTEGER16, 2);
const mode = variable(0x6060, INTEGER8, 0);
const modeDisplay = variable(0x6061, INTEGER8, 0, ro);
const position = variable(0x6064, INTEGER32, 2147483000, ro); // it will wrap
const velocity = variable(0x606c, INTEGER32, 0, ro);
variable(0x6071, INTEGER16, 500);
variable(0x6076, UNSIGNED32, 1500, ro);
const torque = variable(0x6077, INTEGER16, 0, ro);
variable(0x6079, UNSIGNED32, 24500, ro);
const deceleration = variable(0x6085, UNSIGNED32, 1000000);
record(0x60c2, [UNSIGNED8, INTEGER8], [1, -3]);
const target = variable(0x60ff, INTEGER32, 123456); // stale
variable(0x6502, UNSIGNED32, 0x00000100, ro); // cyclic synchronous velocity alone
for (let n = 0; n < 4; ++n) {
  record(0x1400 + n, [UNSIGNED32, UNSIGNED8], [0x80000200 + 0x100 * n + NODE, 255]);
  record(0x1800 + n, [UNSIGNED32, UNSIGNED8], [0xc0000180 + 0x100 * n + NODE, 255]);
  for (const base of [0x1600, 0x1a00]) {
    record(base + n, Array(8).fill(UNSIGNED32), Array(8).fill(0));
  }
}
eds.addSdoServerParameter(127, 0x580 + NODE, 0x600 + NODE);
eds.setSyncCobId(0x80);
eds.setEmcyCobId(0x80 + NODE);

// ---- state machine of CiA 402 -------------------------------------------------------------------

const WORDS = { disabled: 0x0250, ready: 0x0231, on: 0x0233, enabled: 0x0237, quick: 0x0217,
  fault: 0x0218 };
let state = 'disabled';
let last = 0; // controlword
let where = position.value;

function emergency(code) {
  errorCode.value = code;
  device.emcy.write(code, Buffer.from([1, 2, 3, 4, 5]));
}

function command(word) {
  const edge = word & 0x80 && !(last & 0x80);
  last = word;
  if (state === 'fault') {
    if (edge) {
      state = 'disabled';
      errorCode.value = 0;
      device.emcy.write(0, Buffer.alloc(5));
    }
    return;
  }
  // in the order of the profile's command coding; quick stop with option 6 stays until no voltage
  if (!(word & 2)) state = 'disabled';
  else if (!(word & 4)) state = { enabled: 'quick', quick: 'quick' }[state] || 'disabled';
  else if (state === 'quick') return;
  else if ((word & 0x0f) === 0x0f) state = { on: 'enabled', enabled: 'enabled' }[state] || state;
  else if ((word & 7) === 7) state = { ready: 'on', enabled: 'on' }[state] || state;
  else state = 'ready';
}

let stepped = 0;
function step() {
  const dt = (now - stepped) / 1000;
  stepped = now;
  command(controlword.value);
  modeDisplay.value = mode.value;
  let speed = 0;
  if (state === 'enabled' && mode.value === 9) speed = target.value;
  if (state === 'quick') {
    const left = Math.abs(velocity.value) - deceleration.value * dt;
    speed = Math.sign(velocity.value) * Math.max(0, Math.round(left));
    if (speed === 0 && quickStopOption.value === 2) state = 'disabled';
  }
  velocity.value = speed;
  torque.value = Math.sign(speed) * 100;
  where += speed * dt;
  position.value = Math.round(where) | 0;
  statusword.value = WORDS[state];
}

// ---- device -------------------------------------------------------------------------------------

const device = new Device({ id: NODE, eds });

function send(id, data) {
  const text = id.toString(16).toUpperCase().padStart(3, '0');
  process.stdout.write(`${text}#${Buffer.from(data).toString('hex').toUpperCase()}\n`);
}
device.on('message', ({ id, data }) => send(id, data));
device.nmt.on('timeout', () => {
  if (state === 'enabled') state = 'quick'; // 6007 = 3
  emergency(0x8130);
});
device.start();
send(0x700 + NODE, [0]); // the stack sends no boot-up message

const HAPPENINGS = {
  fault() {
    state = 'fault';
    emergency(0x2310);
  },
  emcy(code) {
    emergency(parseInt(code, 16));
  },
  reboot() {
    state = 'disabled';
    device.nmt.enterPreOperational();
    send(0x700 + NODE, [0]);
  },
};

function take(line) {
  if (line[0] === '@') {
    advance(1000 * Number(line.slice(1)));
    process.stdout.write('.\n');
  } else if (line[0] === '!') {
    const [what, ...rest] = line.slice(1).split(' ');
    HAPPENINGS[what](...rest);
  } else {
    const [id, data] = line.split('#');
    const frame = { id: parseInt(id, 16), data: Buffer.from(data, 'hex') };
    if (frame.id === 0x80) step();
    device.receive({ ...frame, len: frame.data.length });
    // what came by SDO is obeyed at once; process data with SYNC
    if (frame.id === 0x600 + NODE && frame.data[0] >> 5 === 1) {
      if (frame.data.readUInt16LE(1) === 0x6040) command(controlword.value);
      statusword.value = WORDS[state];
    }
  }
}

let rest = '';
process.stdin.on('data', (chunk) => {
  const lines = (rest + chunk).split('\n');
  rest = lines.pop();
  lines.forEach(take);
});
process.stdin.on('end', () => process.exit(0));
