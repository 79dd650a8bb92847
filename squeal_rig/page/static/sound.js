"use strict";
// Sound: pieces follow one another on the sample grid, without a gap; the volume is limited before the loudspeaker.

const sound = (() => {
  const AHEAD = 0.3, MOST = 1.5;
  let context = null, gain = null, begin = 0, origin = -1, from = 0, gaps = 0, pieces = 0, next = 0;
  // The microphone of a test: everything received, before gain and limiter.
  const received = [];
  let keep = false;

  function start(volume) {
    context = new AudioContext({ latencyHint: "interactive", sampleRate: 48000 });
    const rest = context.createBiquadFilter();  // the static displacement is no sound
    rest.type = "highpass";
    rest.frequency.value = 20;
    gain = context.createGain();
    gain.gain.value = volume;
    const press = context.createDynamicsCompressor();
    press.threshold.value = -12; press.ratio.value = 20; press.attack.value = 0.002; press.release.value = 0.1;
    const limit = context.createWaveShaper();  // never above half of full scale, whatever comes
    limit.curve = Float32Array.from({ length: 2049 }, (_, k) => 0.5 * Math.tanh((k - 1024) / 512));
    gain.connect(rest).connect(press).connect(limit).connect(context.destination);
    origin = -1; gaps = 0; pieces = 0;
    return context.sampleRate;
  }

  function take(head, samples) {
    if (!context || head.rate !== context.sampleRate) return;
    pieces++;
    if (keep) received.push({ origin: head.origin, first: head.first, samples: samples.slice() });
    const now = context.currentTime;
    const seam = origin === head.origin && head.first === next;
    let at = begin + (head.first - from) / head.rate;
    if (!seam || at < now || at > now + MOST) {
      if (origin >= 0) gaps++;
      origin = head.origin; from = head.first;
      begin = Math.ceil((now + AHEAD) * head.rate) / head.rate;
      at = begin;
    }
    next = head.first + samples.length;
    const buffer = context.createBuffer(1, samples.length, head.rate);
    buffer.copyToChannel(samples, 0);
    const source = context.createBufferSource();
    source.buffer = buffer;
    source.connect(gain);
    source.start(at);
  }

  function stop() { if (context) context.close(); context = null; }
  function volume(value) { if (gain) gain.gain.value = value; }
  const state = () => (context ? `${context.sampleRate} Hz, ${gaps} gaps` : "");
  return { start, take, stop, volume, state, received, record: (on) => { keep = on; }, running: () => context !== null,
    rate: () => (context ? context.sampleRate : 0), counts: () => ({ gaps, pieces }) };
})();
