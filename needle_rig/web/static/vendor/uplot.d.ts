/** Part of uPlot's own declarations: what the page uses. */
export type Values = (number | null)[];
export interface Series {
  label?: string;
  stroke?: () => string;
  width?: number;
  dash?: number[];
  points?: object;
  paths?: (plot: uPlot, series: number, first: number, last: number) => { stroke: Path2D } | null;
  facets?: object[];
}
export default class uPlot {
  constructor(options: object, data: unknown[], parent: HTMLElement);
  readonly ctx: CanvasRenderingContext2D;
  readonly bbox: { left: number; top: number; width: number; height: number };
  readonly cursor: { idx: number | null; left: number; top: number };
  readonly select: { left: number; width: number };
  readonly scales: Record<string, { min: number; max: number }>;
  setData(data: unknown[]): void;
  setSelect(select: { left: number; width: number; top: number; height: number }, fire: boolean): void;
  setSize(size: { width: number; height: number }): void;
  posToVal(position: number, scale: string): number;
  valToPos(value: number, scale: string, canvas?: boolean): number;
  redraw(): void;
  destroy(): void;
}
