/** Samples of a stream in the order of time: a ring of fixed length, read by bounds of time. */
export class Ring {
  readonly columns: number;
  readonly capacity: number;
  private readonly times: Float64Array;
  private readonly values: Float32Array[];
  private first = 0;
  private count = 0;

  constructor(columns: number, capacity: number) {
    this.columns = columns;
    this.capacity = capacity;
    this.times = new Float64Array(capacity);
    this.values = Array.from({ length: columns }, () => new Float32Array(capacity));
  }

  get length(): number {
    return this.count;
  }

  /** Time of the newest sample [s]; -Infinity without any. */
  get newest(): number {
    return this.count ? this.time(this.count - 1) : -Infinity;
  }

  clear(): void {
    this.first = 0;
    this.count = 0;
  }

  /** Take samples: `data` holds columns one after the other, the first of them the time since `t0` [s]. */
  push(n: number, t0: number, data: Float32Array): void {
    if (data.length !== n * (this.columns + 1)) throw new Error(`${data.length} numbers are not ${n} samples`);
    for (let i = Math.max(0, n - this.capacity); i < n; i++) {
      const time = t0 + (data[i] as number);
      // a time before the newest one belongs to a publisher that began again: what was there cannot be ordered with it
      if (time < this.newest) this.clear();
      const place = (this.first + this.count) % this.capacity;
      this.times[place] = time;
      for (let c = 0; c < this.columns; c++) {
        (this.values[c] as Float32Array)[place] = data[(c + 1) * n + i] as number;
      }
      if (this.count < this.capacity) this.count++;
      else this.first = (this.first + 1) % this.capacity;
    }
  }

  time(index: number): number {
    return this.times[(this.first + index) % this.capacity] as number;
  }

  value(column: number, index: number): number {
    return (this.values[column] as Float32Array)[(this.first + index) % this.capacity] as number;
  }

  /** Index of the first sample at or after a time. */
  indexAt(time: number): number {
    let low = 0;
    let high = this.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Newest number of a column that is one; NaN without any. */
  last(column: number): number {
    for (let i = this.count - 1; i >= 0 && i >= this.count - 50; i--) {
      const value = this.value(column, i);
      if (!Number.isNaN(value)) return value;
    }
    return NaN;
  }
}

/** A point of a curve: a number, a gap (null), or nothing there although the curve continues (undefined). */
export type Point = number | null | undefined;

/** Places on the time axis for `buckets` buckets of two points each. */
export function grid(from: number, to: number, buckets: number): Float64Array {
  const width = (to - from) / buckets;
  return Float64Array.from({ length: 2 * buckets }, (_, i) => from + width * ((i >> 1) + (i & 1 ? 0.75 : 0.25)));
}

/**
 * Least and greatest value of each bucket, in the order in which they came, so that no spike disappears.
 * `gap` is the time without samples from which on the curve is broken [s].
 */
export function minMax(ring: Ring, column: number, from: number, to: number, buckets: number, gap: number): Point[] {
  const points: Point[] = new Array<Point>(2 * buckets).fill(undefined);
  const width = (to - from) / buckets;
  let i = ring.indexAt(from);
  let before = i > 0 ? ring.time(i - 1) : -Infinity;
  let next = 0;
  const end = ring.indexAt(to);
  while (i < end) {
    const bucket = Math.min(buckets - 1, Math.floor((ring.time(i) - from) / width));
    if (ring.time(i) - before > gap) points.fill(null, 2 * next, 2 * bucket);
    let least = Infinity;
    let greatest = -Infinity;
    let leastAt = -1;
    let greatestAt = -1;
    let unknown = false;
    for (; i < end && Math.min(buckets - 1, Math.floor((ring.time(i) - from) / width)) === bucket; i++) {
      const value = ring.value(column, i);
      before = ring.time(i);
      if (Number.isNaN(value)) {
        unknown = true;
        continue;
      }
      if (value < least) [least, leastAt] = [value, i];
      if (value > greatest) [greatest, greatestAt] = [value, i];
    }
    if (leastAt < 0) {
      if (unknown) points.fill(null, 2 * bucket, 2 * bucket + 2);
    } else {
      points[2 * bucket] = leastAt <= greatestAt ? least : greatest;
      points[2 * bucket + 1] = leastAt <= greatestAt ? greatest : least;
    }
    next = bucket + 1;
  }
  if (to - before > gap) points.fill(null, 2 * next);
  return points;
}
