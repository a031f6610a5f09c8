export default class uPlot {
  constructor(options: any, data: any[], parent: HTMLElement);
  setData(data: any[]): void;
  setSize(size: { width: number; height: number }): void;
  redraw(): void;
  destroy(): void;
}
